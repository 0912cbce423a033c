"""SAM2 and SAM3: masks of one image by clicks, box or words, and tracks through the other views."""

import importlib
from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    SUBJECT,
    Box,
    Click,
    Detector,
    MaskLogits,
    Proposal,
    Segmenter,
    Tracks,
)
from edit3r.contract.reporting import note, progress
from edit3r.contract.settings import PartChoice, Settings
from edit3r.kit import asking
from edit3r.kit.cache import fingerprint, remembered
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.segmenting import enlarged, mask_in_box
from edit3r.kit.weights.load import (
    ChosenWeights,
    foreign,
    identity,
    load_pretrained,
    out_of_memory_told,
    pick_device,
    require_at_hand,
    sized,
)
from edit3r_segmenters import OF_HUB, SAM2, SAM2_TINY

TEXT_LENGTH = 32  # tokens that SAM3's text encoder takes
MOST_KEPT = (
    4  # images whose embeddings stay in memory: clicks follow each other on one image
)


class SamSettings(Settings):
    """Settings of every generation."""

    model: str
    revision: str = ""
    """branch, tag or commit of the model; empty: the declared commit"""
    local_files_only: bool = False
    """never download"""
    device: str = "auto"
    """cpu, cuda, ...; auto: where the photos are (--device)"""


class SamSegmenter(Segmenter):
    """All but how words are read."""

    image_class: ClassVar[str]  # of transformers: answers points and boxes
    video_class: ClassVar[str]  # follows objects
    session: ClassVar[str]  # module:class of what that one remembers
    mean: ClassVar[tuple[float, float, float]]  # of the training images, sRGB
    std: ClassVar[tuple[float, float, float]]

    settings: SamSettings

    def __init__(self, settings: SamSettings) -> None:
        self.settings = settings
        self.weights = ChosenWeights(
            settings.model,
            "segmenter.model",
            settings.revision,
            local_files_only=settings.local_files_only,
            known=OF_HUB,
        )
        require_at_hand(self.weights)
        self._models: dict[str, Any] = {}
        self._embeddings: dict[str, list[Tensor]] = {}

    def masks(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[Click],
        box: Box | None = None,
        before: Float[Tensor, "h w"] | None = None,
    ) -> MaskLogits:
        """The network's three masks, at its own resolution, and their predicted IoU."""
        model = self._model(self.image_class, image.device)
        places, on = [place for place, _ in clicks], [inside for _, inside in clicks]
        prompts = self._prompts(model, places, on, box)
        if before is not None:
            mask = before[None, None]
            prompts["input_masks"] = mask.to(model.device, model.dtype)
        with torch.no_grad(), self._memory("segmenting"):
            output = model(image_embeddings=self._embed(model, image), **prompts)
        logits, quality = output.pred_masks[0, 0], output.iou_scores[0, 0]
        return MaskLogits(logits.float().cpu(), quality.float().cpu())

    def _prompts(
        self,
        model: Any,
        points: Sequence[tuple[float, float]],
        on: Sequence[bool],
        box: Box | None,
    ) -> dict[str, Tensor]:
        """Points, whether the object is there, and a box, as the network takes them."""
        side = model.config.prompt_encoder_config.image_size
        like = {"device": model.device, "dtype": model.dtype}
        prompts: dict[str, Tensor] = {}
        if points:
            places = [[[list(point) for point in points]]]
            prompts["input_points"] = side * torch.tensor(places, **like)
            prompts["input_labels"] = torch.tensor(
                [[[int(one) for one in on]]], device=model.device
            )
        if box is not None:
            x, y, w, h = box
            prompts["input_boxes"] = side * torch.tensor(
                [[[x, y, x + w, y + h]]], **like
            )
        return prompts

    @remembered
    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        if not len(masks):
            nobody = torch.zeros(len(images), 0, dtype=torch.bool, device=images.device)
            return Tracks(images.new_zeros(len(images), 0, *images.shape[-2:]), nobody)
        model = self._model(self.video_class, images.device)
        with torch.no_grad(), self._memory("tracking objects"):
            tracks = self._follow(
                model, images.to(model.device), masks.to(model.device, torch.float32)
            )
        return Tracks(tracks.logits.to(images.device), tracks.present.to(images.device))

    def _embed(
        self, model: Any, image: Float[Tensor, "3 height width"]
    ) -> list[Tensor]:
        key = fingerprint(image)
        if key not in self._embeddings:
            if len(self._embeddings) >= MOST_KEPT:
                self._embeddings.clear()
            pixels = self._pixels(
                image[None].float(), model.config.prompt_encoder_config.image_size
            )
            self._embeddings[key] = model.get_image_embeddings(
                pixels.to(model.device, model.dtype)
            )
        return list(self._embeddings[key])

    def _pixels(
        self, images: Float[Tensor, "n 3 height width"], side: int
    ) -> Float[Tensor, "n 3 side side"]:
        """Make the network's input of images in [0, 1]: squashed to a square, as prompts are, and
        normalised.
        """
        square = F.interpolate(
            images, (side, side), mode="bilinear", antialias=True, align_corners=False
        )
        mean, std = (
            images.new_tensor(values)[:, None, None] for values in (self.mean, self.std)
        )
        return (square - mean) / std

    def _model(self, name: str, photos_on: torch.device) -> Any:
        """Load one of the classes when it is first needed; all read the same weights."""
        if name not in self._models:
            model = load_whole_network(
                foreign("transformers", name), self.weights, dtype=torch.float32
            )
            with self._memory("loading " + name):
                device = pick_device(
                    self.settings.device, photos_on, "segmenter.device"
                )
                self._models[name] = model.to(device).eval()
            note("segmenter.weights", identity(self.weights))
        return self._models[name]

    def _memory(self, doing: str) -> AbstractContextManager[None]:
        return out_of_memory_told(
            doing,
            "try a smaller --set segmenter.model, or segmenter.device=cpu",
        )

    def _follow(
        self,
        model: Any,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        """Follow objects given on view 0 with the video predictor, the views taken as the frames of
        a video.
        """
        module, _, name = self.session.partition(":")
        views, size = len(images), size_of(images)
        side = model.config.image_size
        session = getattr(importlib.import_module(module), name)(
            video=self._pixels(images, side),
            video_height=size[0],
            video_width=size[1],
            inference_device=images.device,
            inference_state_device=images.device,
            video_storage_device=images.device,
            dtype=model.dtype,
        )
        for number, mask in enumerate(binary_masks(masks, side)):
            session.add_mask_inputs(session.obj_id_to_idx(number), 0, mask[None, None])
        session.obj_with_new_inputs = list(range(len(masks)))
        # turns the masks into memories; propagation alone refuses to start
        model(session, frame_idx=0)
        logits, present = [], []
        for output in model.propagate_in_video_iterator(session):
            logits.append(enlarged(output.pred_masks[:, 0], size))
            present.append(is_present(logits[-1], output.object_score_logits))
            progress("tracking objects", len(logits), views)
        return Tracks(torch.stack(logits), torch.stack(present))


class Sam2Segmenter(SamSegmenter):
    """SAM2 (Ravi et al. 2024), the paper's segmenter; words become boxes by a detector, and boxes
    masks.
    """

    image_class, video_class = "Sam2Model", "Sam2VideoModel"
    session = (
        "transformers.models.sam2_video.modeling_sam2_video:Sam2VideoInferenceSession"
    )
    mean, std = IMAGENET_MEAN, IMAGENET_STD

    class Settings(SamSettings):
        model: str = Field(default_factory=partial(sized, SAM2, SAM2_TINY))
        """model id on the hub, or a saved folder; where none is given the tiny one for a CPU, the
        large one for a GPU or where only that was fetched
        """
        detector: PartChoice = PartChoice(name="grounding-dino")
        """finds what the words name"""

    settings: Settings

    def __init__(self, settings: Settings, detector: Detector) -> None:
        super().__init__(settings)
        self.detector = detector

    @remembered
    def words(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        if text == SUBJECT:
            return None
        height, width = image.shape[-2:]
        return tuple(
            Proposal(
                mask_in_box(
                    self, image, (x / width, y / height, w / width, h / height)
                ),
                one.score,
            )
            for one in asking.detect(self.detector, image, text)
            for x, y, w, h in [one.box]
        )


class Sam3Segmenter(SamSegmenter):
    """SAM3 (Carion et al. 2025): every instance of what a few words name, without a detector.

    Its image processor and its box prompts for concepts need torchvision; neither is used here.
    """

    image_class, video_class = "Sam3TrackerModel", "Sam3TrackerVideoModel"
    session = (
        "transformers.models.sam3_tracker_video.modeling_sam3_tracker_video:"
        "Sam3TrackerVideoInferenceSession"
    )
    mean = std = (0.5, 0.5, 0.5)

    class Settings(SamSettings):
        model: str = "facebook/sam3"
        """model id on the hub, or a saved folder"""
        min_score: float = Field(0.5, ge=0, le=1)
        """least score of what the words name"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings)
        self._tokenizer: Any = None

    @remembered
    def words(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        if text == SUBJECT:
            return None
        if self._tokenizer is None:
            self._tokenizer = load_pretrained(
                foreign("transformers", "CLIPTokenizer"), self.weights
            )
        model = self._model("Sam3Model", image.device)
        # it was trained on noun phrases such as "yellow school bus"
        words = text.strip().lower().removeprefix("the ")
        tokens = self._tokenizer(
            words,
            return_tensors="pt",
            padding="max_length",
            max_length=TEXT_LENGTH,
            truncation=True,
        ).to(model.device)
        pixels = self._pixels(
            image[None].float(), model.config.vision_config.image_size
        ).to(model.device)
        with torch.no_grad(), self._memory("segmenting"):
            found = model(pixel_values=pixels, **tokens)
        scores = found.pred_logits[0].sigmoid() * found.presence_logits[0].sigmoid()
        best = [
            index
            for index in scores.argsort(descending=True).tolist()
            if scores[index] >= self.settings.min_score
        ]
        masks = enlarged(found.pred_masks[0, best], size_of(image)).to(image.device)
        return tuple(
            Proposal(mask.sigmoid(), float(scores[index]))
            for mask, index in zip(masks, best)
            if bool((mask > 0).any())
        )


def is_present(
    logits: Float[Tensor, "object height width"], scores: Float[Tensor, "object *_"]
) -> Bool[Tensor, "object"]:
    """Tell which objects are in a frame: those with a positive score or a mask that is not empty.

    The predictor's `object_ids` always lists every object, lost or not, so it cannot serve as the
    paper's O_v.
    """
    return (scores.flatten() > 0) | (logits > 0).flatten(1).any(1)


def binary_masks(
    masks: Float[Tensor, "object height width"], side: int
) -> Float[Tensor, "object side side"]:
    """Make the tracker's 0/1 masks of soft masks in [0, 1]."""
    square = F.interpolate(
        masks[:, None],
        (side, side),
        mode="bilinear",
        antialias=True,
        align_corners=False,
    )
    return (square[:, 0] >= 0.5).to(masks)


def load_whole_network(cls: Any, weights: ChosenWeights, **given: Any) -> Any:
    """A network by `load_pretrained`, refused where the files lack weights of it."""
    network, report = load_pretrained(cls, weights, output_loading_info=True, **given)
    lacking = sorted(report["missing_keys"] or report["mismatched_keys"])
    if lacking:
        raise InputError(
            f"{weights.key}: {weights.model!r} lacks {len(lacking)} weights of {cls.__name__}, "
            f"such as {lacking[0]}; with random ones in their place its answers would mean nothing."
        )
    return network
