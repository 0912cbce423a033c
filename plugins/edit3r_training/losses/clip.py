"""Image-image CLIP loss: 1 - cosine of the embeddings of rendering and target (L_CLIP)."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.errors import MissingDependencyError
from edit3r.interfaces import Loss, LossInputs
from edit3r_training.losses.needs import require

_MEAN = (0.48145466, 0.4578275, 0.40821073)
_STD = (0.26862954, 0.26130258, 0.27577711)


class ClipLoss(Loss):
    """Mean over pictures of 1 - cosine similarity of CLIP's image embeddings."""

    class Settings(config.Settings):
        model: str = Field("openai/clip-vit-base-patch32", description="folder or hub name of a CLIP model")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._model = _frozen_clip(settings.model)

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require(inputs, "clip", "rendered", "target")
        predicted = self._embed(inputs.rendered.flatten(0, 1))
        with torch.no_grad():
            wished = self._embed(inputs.target.flatten(0, 1))
        return 1 - F.cosine_similarity(predicted, wished, dim=-1).mean()

    def _embed(self, images: Tensor) -> Tensor:
        side = self._model.config.image_size
        x = F.interpolate(images, (side, side), mode="bicubic", align_corners=False, antialias=True)
        x = (x - x.new_tensor(_MEAN)[:, None, None]) / x.new_tensor(_STD)[:, None, None]
        return self._model.to(x.device)(pixel_values=x).image_embeds


def _frozen_clip(name: str):
    from transformers import CLIPVisionModelWithProjection

    try:
        return CLIPVisionModelWithProjection.from_pretrained(name).eval().requires_grad_(False)
    except OSError as error:
        reason = str(error).splitlines()[0]
        raise MissingDependencyError(
            f"loss 'clip' could not load {name!r} ({reason}); give model=FOLDER of a downloaded CLIP model."
        ) from error
