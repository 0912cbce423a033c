"""SAM2's own preparation of pictures, without torchvision: squashed to a square, normalised as ImageNet."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


def pixel_values(images: Float[Tensor, "n 3 height width"], side: int) -> Float[Tensor, "n 3 side side"]:
    """Network input of pictures in [0, 1]; the shape is not kept, and prompts are squashed along."""
    square = F.interpolate(images, (side, side), mode="bilinear", antialias=True, align_corners=False)
    mean, std = (images.new_tensor(values)[:, None, None] for values in (MEAN, STD))
    return (square - mean) / std


def binary_masks(masks: Float[Tensor, "object height width"], side: int) -> Float[Tensor, "object side side"]:
    """0/1 masks for the tracker of soft masks in [0, 1]."""
    square = F.interpolate(masks[:, None], (side, side), mode="bilinear", antialias=True, align_corners=False)
    return (square[:, 0] >= 0.5).to(masks)


def enlarge(logits: Float[Tensor, "*n h w"], size: tuple[int, int]) -> Float[Tensor, "*n height width"]:
    """The network's small masks at the photo's size, still logits."""
    flat = logits.flatten(0, -3)[:, None]
    large = F.interpolate(flat.float(), size, mode="bilinear", align_corners=False)
    return large[:, 0].unflatten(0, logits.shape[:-2])
