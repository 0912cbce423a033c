"""Networks that images are compared by: features for Fréchet and kernel distances, and CLIP's
similarity to words.

Each feature network names its metrics, for they do not mix. `effnet` works offline. `inception`
needs the TorchScript file `inception-2015-12-05.pt`, by which StyleGAN's and clean-fid's FID are
defined, and which the user brings. CLIP needs transformers and CLIP weights.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.compute.perceptual import efficientnet_input, frozen_efficientnet
from edit3r.errors import InputError
from edit3r.io.pretrained import ChosenWeights, foreign, load_pretrained

CROPS = 5  # pieces that an image is compared by: itself and its four corners
CORNER = 0.6  # side of a corner piece [image sides]
EFFNET_SIZE = 128  # side that images are resized to for EfficientNet [pixels]

CLIP_MODEL = "openai/clip-vit-large-patch14"
CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
CLIP_STD = (0.26862954, 0.26130258, 0.27577711)


class EffnetFeatures:
    """The 1280 pooled features of EfficientNet-lite0."""

    suffix = "-effnet"

    def __init__(self) -> None:
        self.network = frozen_efficientnet()

    @torch.no_grad()
    def __call__(
        self, images: Float[Tensor, "n 3 height width"]
    ) -> Float[np.ndarray, "n feature"]:
        """Return features of images in [0, 1]."""
        maps = self.network.extract_features(efficientnet_input(images, EFFNET_SIZE))
        return maps.mean((2, 3)).double().numpy()


class InceptionFeatures:
    """The 2048 features that FID and KID are defined on, from a TorchScript file; it resizes images
    itself.
    """

    suffix = ""  # of the metrics' names: FID and KID themselves

    def __init__(self, file: str | Path) -> None:
        path = Path(file).expanduser()
        if not path.is_file():
            raise InputError(
                f"{path}: no such file; expected the TorchScript inception-2015-12-05.pt."
            )
        try:
            self.network = torch.jit.load(str(path), map_location="cpu").eval()
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(
                f"{path}: not a TorchScript file such as inception-2015-12-05.pt ({reason})."
            ) from None

    @torch.no_grad()
    def __call__(
        self, images: Float[Tensor, "n 3 height width"]
    ) -> Float[np.ndarray, "n feature"]:
        """Return features of images in [0, 1]."""
        pixels = (images.clamp(0, 1) * 255).round().to(torch.uint8)
        return self.network(pixels, return_features=True).double().numpy()


FeatureNetwork = (
    EffnetFeatures | InceptionFeatures
)  # a frozen network from images to one vector each


def crops(
    images: Float[Tensor, "n 3 height width"],
) -> Float[Tensor, "n5 3 height width"]:
    """Return each image and its four corners enlarged to its size: a scene alone has too few images
    to compare.
    """
    height, width = images.shape[-2:]
    tall, wide = max(1, round(CORNER * height)), max(1, round(CORNER * width))
    corners = [
        images[..., y, x]
        for y in (slice(tall), slice(-tall, None))
        for x in (slice(wide), slice(-wide, None))
    ]
    enlarged = [
        F.interpolate(c, (height, width), mode="bilinear", align_corners=False)
        for c in corners
    ]
    return torch.cat((images, *enlarged))


class ClipSimilarity:
    """Cosines between images and texts by a frozen CLIP (the paper's CLIP t2i), about 0.2 to 0.3
    for good pairs.
    """

    def __init__(self, model: str = CLIP_MODEL, local_files_only: bool = False) -> None:
        weights = ChosenWeights(model, "clip.model", local_files_only=local_files_only)
        model_class = foreign("transformers", "CLIPModel")
        self.model = (
            load_pretrained(model_class, weights, dtype=torch.float32)
            .eval()
            .requires_grad_(False)
        )
        self.tokenizer = load_pretrained(
            foreign("transformers", "CLIPTokenizerFast"), weights
        )

    def __call__(
        self, images: Float[Tensor, "n 3 height width"], texts: list[str]
    ) -> Float[Tensor, "n text"]:
        """Return the cosine of every image in [0, 1] with every text, in [-1, 1]."""
        return self.embed_images(images) @ self.embed_texts(texts).to(images.device).T

    def embed_images(
        self, images: Float[Tensor, "n 3 height width"]
    ) -> Float[Tensor, "n channel"]:
        """Return unit embeddings of images of any one size."""
        network: Any = self.model.to(images.device)
        pixels = central_square(images, self.model.config.vision_config.image_size)
        return F.normalize(
            network.visual_projection(network.vision_model(pixels).pooler_output),
            dim=-1,
        )

    def embed_texts(self, texts: list[str]) -> Float[Tensor, "text channel"]:
        """Return unit embeddings of texts, which are cut after CLIP's 77 tokens."""
        tokens = self.tokenizer(
            texts, padding=True, truncation=True, max_length=77, return_tensors="pt"
        )
        tokens = tokens.to(self.model.device)
        pooled = self.model.text_model(
            tokens.input_ids, attention_mask=tokens.attention_mask
        ).pooler_output
        return F.normalize(self.model.text_projection(pooled), dim=-1)


def direction_similarity(
    clip: ClipSimilarity,
    before: Float[Tensor, "n 3 height width"],
    after: Float[Tensor, "n 3 height width"],
    text_before: str,
    text_after: str,
) -> Float[Tensor, "n"]:
    """Return the cosine between how images moved and how the text did (StyleGAN-NADA, 2022); 0 for
    one left alone.
    """
    moved = clip.embed_images(after) - clip.embed_images(before)
    start, end = clip.embed_texts([text_before, text_after]).to(moved)
    return F.cosine_similarity(moved, (end - start)[None], dim=-1)


def prompt_quality(
    clip: ClipSimilarity, images: Float[Tensor, "n 3 height width"], good: str, bad: str
) -> float:
    """Return the mean probability in [0, 1] that images look `good`, not `bad` (CLIP-IQA, Wang et
    al. 2023).
    """
    cosines = clip(images, [good, bad])
    return float((100 * (cosines[:, 0] - cosines[:, 1])).sigmoid().mean())


def central_square(
    images: Float[Tensor, "n 3 height width"], side: int
) -> Float[Tensor, "n 3 side side"]:
    """Prepare images as CLIP does, in torch so that gradients pass: shorter side to `side`, centre
    cut, normalised.
    """
    height, width = images.shape[-2:]
    scale = side / min(height, width)
    size = (max(side, round(height * scale)), max(side, round(width * scale)))
    scaled = F.interpolate(
        images, size, mode="bicubic", antialias=True, align_corners=False
    ).clamp(0, 1)
    top, left = (size[0] - side) // 2, (size[1] - side) // 2
    mean, std = (
        images.new_tensor(values)[:, None, None] for values in (CLIP_MEAN, CLIP_STD)
    )
    return (scaled[..., top : top + side, left : left + side] - mean) / std
