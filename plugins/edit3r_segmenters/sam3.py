"""SAM3 (Carion et al. 2025): every instance of what a few words name, without a detector; clicks and tracks as SAM2.

Its image processor and its box prompts for concepts need torchvision; neither is used here.
"""

from typing import Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.cache import remembered
from edit3r.interfaces import Proposal
from edit3r.io.pretrained import foreign, load_pretrained
from edit3r_segmenters.sam import SamSegmenter, SamSettings, enlarge, proposal

TEXT_LENGTH = 32  # tokens that its text encoder takes


class Sam3Segmenter(SamSegmenter):
    """Masks of one image by words, grid, point or box, and their tracks through the other views."""

    image_class, video_class = "Sam3TrackerModel", "Sam3TrackerVideoModel"
    session = "transformers.models.sam3_tracker_video.modeling_sam3_tracker_video:Sam3TrackerVideoInferenceSession"
    mean = std = (0.5, 0.5, 0.5)
    threshold_key = "segmenter.min_score"

    class Settings(SamSettings):
        model: str = Field("facebook/sam3", description="model id on the hub, or a saved folder")
        min_score: float = Field(0.5, ge=0, le=1, description="least score of what the words name")

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._tokenizer: Any = None

    @remembered
    def segment_text(self, image: Float[Tensor, "3 height width"], text: str) -> tuple[Proposal, ...]:
        if self._tokenizer is None:
            self._tokenizer = load_pretrained(foreign("transformers", "CLIPTokenizer"), self.weights)
        model = self._model("Sam3Model", image.device)
        words = text.strip().lower().removeprefix("the ")  # it was trained on noun phrases such as "yellow school bus"
        tokens = self._tokenizer(
            words, return_tensors="pt", padding="max_length", max_length=TEXT_LENGTH, truncation=True
        ).to(model.device)
        pixels = self._pixels(image[None].float(), model.config.vision_config.image_size).to(model.device)
        with torch.no_grad(), self._memory("segmenting"):
            found = model(pixel_values=pixels, **tokens)
        scores = found.pred_logits[0].sigmoid() * found.presence_logits[0].sigmoid()
        best = [index for index in scores.argsort(descending=True).tolist() if scores[index] >= self.settings.min_score]
        masks = enlarge(found.pred_masks[0, best], tuple(image.shape[-2:])).to(image.device)
        return tuple(proposal(mask, float(scores[index])) for mask, index in zip(masks, best) if bool((mask > 0).any()))
