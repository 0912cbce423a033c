"""Networks that images are compared by: features for Fréchet and kernel distances, and CLIP's
similarity to words.

Each feature network names its metrics, for they do not mix. `effnet` works offline. `inception`
needs the TorchScript file `inception-2015-12-05.pt`, by which StyleGAN's and clean-fid's FID are
defined, and which the user brings. CLIP needs transformers and CLIP weights.
"""

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.enhance import normalize
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.kit.compute.perceptual import (
    CLIP_MEAN,
    CLIP_STD,
    efficientnet_input,
    frozen_efficientnet,
)
from edit3r.kit.files.names import expanded
from edit3r.kit.weights.load import ChosenWeights, foreign, load_pretrained
from edit3r_bench.metrics import Features

Images = Float[Tensor, "n 3 height width"]

CROPS = 5  # pieces that an image is compared by: itself and its four corners
CORNER = 0.6  # side of a corner piece [image sides]; no figure kept
EFFNET_SIZE = 128  # side that images are resized to for EfficientNet [pixels]

CLIP_MODEL = "openai/clip-vit-large-patch14"


class EffnetFeatures:
    """The 1280 pooled features of EfficientNet-lite0."""

    suffix = "-effnet"

    def __init__(self) -> None:
        self.network = frozen_efficientnet()

    @torch.no_grad()
    def __call__(self, images: Images) -> Features:
        """Return features of images in [0, 1]."""
        maps = self.network.extract_features(efficientnet_input(images, EFFNET_SIZE))
        return maps.mean((2, 3)).double().numpy()


class InceptionFeatures:
    """The 2048 features that FID and KID are defined on, of a TorchScript file, which resizes."""

    suffix = ""  # of the metrics' names: FID and KID themselves

    def __init__(self, file: str | Path) -> None:
        path = expanded(file)
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
    def __call__(self, images: Images) -> Features:
        """Return features of images in [0, 1]."""
        pixels = (images.clamp(0, 1) * 255).round().to(torch.uint8)
        return self.network(pixels, return_features=True).double().numpy()


# A frozen network from images to one vector each
FeatureNetwork = EffnetFeatures | InceptionFeatures


def crops(images: Images) -> Images:
    """Each image and its four corners, enlarged: a scene alone has too few images to compare."""
    height, width = images.shape[-2:]
    tall = max(1, round(CORNER * height))
    wide = max(1, round(CORNER * width))
    pieces = [images]
    for rows in (slice(tall), slice(-tall, None)):
        for columns in (slice(wide), slice(-wide, None)):
            corner = images[..., rows, columns]
            pieces.append(F.interpolate(corner, (height, width), mode="bilinear"))
    return torch.cat(pieces)


class ClipSimilarity:
    """Cosines of images and texts by a frozen CLIP (the paper's t2i); good pairs 0.2 to 0.3."""

    def __init__(self, model: str = CLIP_MODEL, local_files_only: bool = False) -> None:
        weights = ChosenWeights(model, "clip.model", local_files_only=local_files_only)
        clip = foreign("transformers", "CLIPModel")
        tokenizer = foreign("transformers", "CLIPTokenizerFast")
        loaded = load_pretrained(clip, weights, dtype=torch.float32)
        self.model = loaded.eval().requires_grad_(False)
        self.tokenizer = load_pretrained(tokenizer, weights)

    def __call__(self, images: Images, texts: list[str]) -> Float[Tensor, "n text"]:
        """Return the cosine of every image in [0, 1] with every text, in [-1, 1]."""
        return self.embed_images(images) @ self.embed_texts(texts).T

    def embed_images(self, images: Images) -> Float[Tensor, "n channel"]:
        """Return unit embeddings of images of any one size."""
        side = self.model.config.vision_config.image_size
        seen = self.model.vision_model(central_square(images, side)).pooler_output
        return F.normalize(self.model.visual_projection(seen), dim=-1)

    def embed_texts(self, texts: list[str]) -> Float[Tensor, "text channel"]:
        """Return unit embeddings of texts, which are cut after CLIP's 77 tokens."""
        tokens = self.tokenizer(
            texts, padding=True, truncation=True, max_length=77, return_tensors="pt"
        )
        read = self.model.text_model(**tokens).pooler_output
        return F.normalize(self.model.text_projection(read), dim=-1)


def directional_similarity(
    clip: ClipSimilarity,
    before: Images,
    after: Images,
    text_before: str,
    text_after: str,
) -> Float[Tensor, "n"]:
    """Cosine between how images moved and how the text did (StyleGAN-NADA, 2022); 0: unmoved."""
    moved = clip.embed_images(after) - clip.embed_images(before)
    start, end = clip.embed_texts([text_before, text_after])
    return F.cosine_similarity(moved, (end - start)[None], dim=-1)


def central_square(images: Images, side: int) -> Float[Tensor, "n 3 side side"]:
    """Prepare images as CLIP does: shorter side to `side`, centre cut, normalised."""
    height, width = images.shape[-2:]
    scale = side / min(height, width)
    size = (max(side, round(height * scale)), max(side, round(width * scale)))
    scaled = F.interpolate(images, size, mode="bicubic", antialias=True).clamp(0, 1)
    top, left = (size[0] - side) // 2, (size[1] - side) // 2
    square = scaled[..., top : top + side, left : left + side]
    return normalize(square, torch.tensor(CLIP_MEAN), torch.tensor(CLIP_STD))
