"""Depth images for a depth-conditioned ControlNet: near is white, one scale for all views of a scene."""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import InputError
from edit3r.interfaces import Matcher
from edit3r.io.pretrained import foreign, load_pretrained
from edit3r.reporting import warn
from edit3r.types import Views
from edit3r_diffusers.loading import DiffusionSettings, part_weights

FAR, NEAR = 0.02, 0.98  # quantiles of disparity drawn black and white
IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def matched_disparity(matcher: Matcher, views: Views) -> Float[Tensor, "view height width"]:
    """Take 1 / depth [1 / scene units] of one scene's views from the matcher: one geometry, so views agree."""
    if views.count < 2:
        raise InputError(
            "controlnet-depth measures depth from two or more photos but is to edit one; leave out --edit-views first, "
            "or name a model that sees depth in one photo, for example "
            "--set editor.depth_model=depth-anything/Depth-Anything-V2-Small-hf."
        )
    geometry = matcher.match(views)
    lost = [view for view, found in enumerate(geometry.registered[0].tolist()) if not found]
    if lost:
        warn(f"controlnet-depth: views {lost} could not be placed; their depth is filled in, not measured.")
    return 1 / geometry.depths[0]


def predicted_disparity(model: Any, images: Float[Tensor, "view 3 height width"]) -> Float[Tensor, "view h w"]:
    """Predict each image's relative disparity by a monocular network (DPT, Depth Anything): not metric, not shared."""
    mean, std = (images.new_tensor(v)[:, None, None] for v in (IMAGENET_MEAN, IMAGENET_STD))
    multiple = int(getattr(model.config, "patch_size", None) or model.config.backbone_config.patch_size)
    side = int(getattr(model.config, "image_size", None) or model.config.backbone_config.image_size)
    scale = side / min(images.shape[-2:])
    size = tuple(max(multiple, round(length * scale / multiple) * multiple) for length in images.shape[-2:])
    pixels = F.interpolate((images - mean) / std, size, mode="bicubic", antialias=True)
    with torch.no_grad():
        return torch.cat([model(pixel_values=image[None].to(model.dtype)).predicted_depth for image in pixels])


def load_predictor(model: str, settings: DiffusionSettings, device: torch.device) -> Any:
    """Load a depth network of transformers by id or folder, in float32."""
    network_class = foreign("transformers", "AutoModelForDepthEstimation")
    network = load_pretrained(network_class, part_weights(model, "depth_model", settings), dtype=torch.float32)
    return network.to(device).eval()


def control_images(disparity: Float[Tensor, "view h w"], size: tuple[int, int]) -> Float[Tensor, "view 3 height width"]:
    """Draw grey images in [0, 1] of `size`: disparity stretched between two quantiles of the whole scene."""
    values = disparity.double().flatten()
    far, near = torch.quantile(values[:: max(1, len(values) // 1_000_000)], values.new_tensor([FAR, NEAR]))
    grey = ((disparity - far) / (near - far).clamp(min=1e-12)).clamp(0, 1).to(disparity.dtype)
    return F.interpolate(grey[:, None], size, mode="bilinear", antialias=True).expand(-1, 3, -1, -1)
