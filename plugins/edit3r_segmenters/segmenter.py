"""SAM2 (Ravi et al. 2024): the paper's segmenter."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.config import PartChoice, Settings
from edit3r.errors import InputError, PromptError
from edit3r.interfaces import Detector, Proposal, Segmenter, Tracks
from edit3r.io.pretrained import Weights, foreign, identity, load_pretrained, out_of_memory_told, pick_device
from edit3r.reporting import note
from edit3r_segmenters import candidates
from edit3r_segmenters.automatic import find_candidates
from edit3r_segmenters.preprocess import enlarge, pixel_values
from edit3r_segmenters.tracking import follow


class Sam2Segmenter(Segmenter):
    """Masks of one picture by grid, point, box or words, and their tracks through the other views.

    With `prompt` set, `propose` returns only what the words name (detector -> boxes -> masks).
    """

    class Settings(Settings):
        model: str = Field("facebook/sam2.1-hiera-large", description="model id on the hub, or a saved folder")
        revision: str = Field("", description="branch, tag or commit of the model; empty: the newest")
        local_files_only: bool = Field(False, description="never download")
        device: str = Field("auto", description="cpu, cuda, ...; auto: where the photos are (--device)")
        prompt: str = Field("", description="what to segment, in words such as 'the bike'; empty: every object")
        detector: PartChoice = Field(PartChoice(name="grounding-dino"), description="finds what the words name")
        points_per_side: int = Field(32, ge=1, le=128, description="grid of the automatic mask generator")
        points_per_batch: int = Field(64, ge=1, le=4096, description="grid points at once; lower needs less memory")
        min_predicted_iou: float = Field(0.8, ge=0, le=1, description="least quality the mask believes it has")
        min_stability: float = Field(0.95, ge=0, le=1, description="least overlap of the mask cut at logits +1 and -1")
        max_box_overlap: float = Field(0.7, ge=0, le=1, description="of two boxes that overlap more, the better stays")

    def __init__(self, settings: Settings, detector: Detector) -> None:
        self.settings, self.detector = settings, detector
        self._models: dict[str, Any] = {}

    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        if self.settings.prompt:
            return self._named(image, self.settings.prompt)
        chosen, size = self.settings, tuple(image.shape[-2:])
        model = self._model("Sam2Model", image.device)
        with torch.no_grad(), self._memory("segmenting"):
            found = find_candidates(
                model,
                self._embed(model, image),
                size,
                chosen.points_per_side,
                chosen.points_per_batch,
                chosen.min_predicted_iou,
                chosen.min_stability,
                chosen.max_box_overlap,
            )
            return tuple(
                candidates.proposal(enlarge(logits[None], size)[0], float(iou))
                for logits, iou in zip(found.logits, found.predicted_iou)
            )

    def segment(
        self,
        image: Float[Tensor, "3 height width"],
        points: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
    ) -> Proposal:
        if not len(points) and box is None:
            raise InputError("segment: give at least one point or a box that says which object is meant.")
        model = self._model("Sam2Model", image.device)
        side = model.config.prompt_encoder_config.image_size
        prompts: dict[str, Tensor] = {}
        if len(points):
            prompts["input_points"] = image.new_tensor([[[list(point) for point in points]]]) * side
        if box is not None:
            x, y, width, height = box
            prompts["input_boxes"] = image.new_tensor([[[x, y, x + width, y + height]]]) * side
        ambiguous = len(points) == 1 and box is None  # one point may mean a part or the whole: ask for all three
        with torch.no_grad(), self._memory("segmenting"):
            output = model(
                image_embeddings=self._embed(model, image), multimask_output=ambiguous, **_in_dtype(prompts, model)
            )
            best = int(output.iou_scores[0, 0].argmax())
            logits = enlarge(output.pred_masks[0, 0, best : best + 1], tuple(image.shape[-2:]))[0]
        return candidates.proposal(logits, float(output.iou_scores[0, 0, best]))

    def track(
        self, images: Float[Tensor, "view 3 height width"], masks: Float[Tensor, "object height width"]
    ) -> Tracks:
        if not len(masks):
            return Tracks(images.new_zeros(len(images), 0, *images.shape[-2:]), _nothing(len(images), images.device))
        model = self._model("Sam2VideoModel", images.device)
        with torch.no_grad(), self._memory("tracking objects"):
            tracks = follow(model, images.to(model.device), masks.to(model.device, torch.float32))
        return Tracks(tracks.logits.to(images.device), tracks.present.to(images.device))

    def segment_text(self, image: Float[Tensor, "3 height width"], text: str) -> tuple[Proposal, ...]:
        height, width = image.shape[-2:]
        boxes = [detection.box for detection in self.detector.detect(image, text)]
        return tuple(self.segment(image, box=(x / width, y / height, w / width, h / height)) for x, y, w, h in boxes)

    def _named(self, image: Float[Tensor, "3 height width"], text: str) -> tuple[Proposal, ...]:
        found = self.segment_text(image, text)
        if not found:
            raise PromptError(
                f"segmenter.prompt: {text!r} was not found on the picture; name it in other words, lower "
                f"segmenter.detector.box_threshold, or give masks with --mask."
            )
        return found

    def _embed(self, model: Any, image: Float[Tensor, "3 height width"]) -> list[Tensor]:
        pixels = pixel_values(image[None].float(), model.config.prompt_encoder_config.image_size)
        return model.get_image_embeddings(pixels.to(model.device, model.dtype))

    def _model(self, name: str, photos_on: torch.device) -> Any:
        """One of transformers' two SAM2 classes, loaded when first needed; both read the same weights."""
        if name not in self._models:
            chosen = self.settings
            weights = Weights(
                chosen.model, "segmenter.model", chosen.revision, local_files_only=chosen.local_files_only
            )
            model = load_pretrained(foreign("transformers", name), weights, dtype=torch.float32)
            with self._memory("loading SAM2"):
                self._models[name] = model.to(pick_device(chosen.device, photos_on, "segmenter.device")).eval()
            note("segmenter.weights", identity(weights))
        return self._models[name]

    def _memory(self, doing: str):
        return out_of_memory_told(
            doing, "try a smaller --set segmenter.points_per_batch, a smaller segmenter.model, or segmenter.device=cpu"
        )


def _in_dtype(prompts: dict[str, Tensor], model: Any) -> dict[str, Tensor]:
    return {name: prompt.to(model.device, model.dtype) for name, prompt in prompts.items()}


def _nothing(views: int, device: torch.device) -> Bool[Tensor, "view 0"]:
    return torch.zeros(views, 0, dtype=torch.bool, device=device)
