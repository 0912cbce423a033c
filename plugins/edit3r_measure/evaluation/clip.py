"""CLIP image-text similarity (the paper's CLIP t2i) and direction: do edited pictures show what the prompt says?

The raw cosine, about 0.2 to 0.3 for good pairs; some tools report it times 100. Needs transformers and CLIP weights.
"""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.io.pretrained import Weights, foreign, load_pretrained

DEFAULT_MODEL = "openai/clip-vit-large-patch14"
MEAN = (0.48145466, 0.4578275, 0.40821073)
STD = (0.26862954, 0.26130258, 0.27577711)


class ClipSimilarity:
    """Cosines between pictures and texts by a frozen CLIP; differentiable in the pictures."""

    def __init__(self, model: str = DEFAULT_MODEL, local_files_only: bool = False) -> None:
        weights = Weights(model, "clip.model", local_files_only=local_files_only)
        model_class = foreign("transformers", "CLIPModel")
        self.model = load_pretrained(model_class, weights, dtype=torch.float32).eval().requires_grad_(False)
        self.tokenizer = load_pretrained(foreign("transformers", "CLIPTokenizerFast"), weights)

    def __call__(self, images: Float[Tensor, "n 3 height width"], texts: list[str]) -> Float[Tensor, "n text"]:
        """Cosine of every picture in [0, 1] with every text, in [-1, 1]."""
        return self.embed_images(images) @ self.embed_texts(texts).to(images.device).T

    def embed_images(self, images: Float[Tensor, "n 3 height width"]) -> Float[Tensor, "n channel"]:
        """Unit embeddings of pictures of any one size."""
        network: Any = self.model.to(images.device)
        pixels = central_square(images, self.model.config.vision_config.image_size)
        return F.normalize(network.visual_projection(network.vision_model(pixels).pooler_output), dim=-1)

    def embed_texts(self, texts: list[str]) -> Float[Tensor, "text channel"]:
        """Unit embeddings of texts, cut after CLIP's 77 tokens."""
        tokens = self.tokenizer(texts, padding=True, truncation=True, max_length=77, return_tensors="pt")
        tokens = tokens.to(self.model.device)
        pooled = self.model.text_model(tokens.input_ids, attention_mask=tokens.attention_mask).pooler_output
        return F.normalize(self.model.text_projection(pooled), dim=-1)


def direction_similarity(
    clip: ClipSimilarity,
    before: Float[Tensor, "n 3 height width"],
    after: Float[Tensor, "n 3 height width"],
    text_before: str,
    text_after: str,
) -> Float[Tensor, "n"]:
    """Cosine between how each picture moved and how the text did (Gal et al., StyleGAN-NADA, 2022), in [-1, 1].

    Unlike t2i it is about the change: 0 for a picture that was left alone, or that changed in another way.
    """
    moved = clip.embed_images(after) - clip.embed_images(before)
    start, end = clip.embed_texts([text_before, text_after]).to(moved)
    return F.cosine_similarity(moved, (end - start)[None], dim=-1)


def central_square(images: Float[Tensor, "n 3 height width"], side: int) -> Float[Tensor, "n 3 side side"]:
    """CLIP's own preparation, in torch so that gradients pass: shorter side to `side`, centre cut out, normalised."""
    height, width = images.shape[-2:]
    scale = side / min(height, width)
    size = (max(side, round(height * scale)), max(side, round(width * scale)))
    scaled = F.interpolate(images, size, mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)
    top, left = (size[0] - side) // 2, (size[1] - side) // 2
    mean, std = (images.new_tensor(values)[:, None, None] for values in (MEAN, STD))
    return (scaled[..., top : top + side, left : left + side] - mean) / std
