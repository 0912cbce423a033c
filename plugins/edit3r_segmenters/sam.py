"""SAM2 and SAM3: masks of one image by grid, point, box or words, and tracks through the other
views.

transformers' own mask-generation pipeline returns boolean masks and predicted IoU only, dropping
stability and logits, which the paper's filter and soft blending need; so the grid of the automatic
mask generator is here.
"""

import importlib
from abc import abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import (
    Detector,
    Marks,
    Proposal,
    Segmenter,
    Tracks,
    as_proposal,
)
from edit3r.contract.reporting import note, progress
from edit3r.contract.settings import PartChoice, Settings
from edit3r.kit.cache import fingerprint, remembered
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.weights.load import (
    ChosenWeights,
    foreign,
    identity,
    load_pretrained,
    load_whole_network,
    out_of_memory_told,
    pick_device,
    require_at_hand,
    sized,
)
from edit3r_segmenters import OF_HUB, SAM2, SAM2_TINY
from edit3r_segmenters.masks import stepped

STABILITY_OFFSET = 1.0  # logits
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
    prompt: str = ""
    """what to segment, in words such as 'the bike'; empty: every object"""
    points_per_side: int = Field(32, ge=1, le=128)
    """grid of the automatic mask generator"""
    points_per_batch: int = Field(64, ge=1, le=4096)
    """grid points at once; lower needs less memory"""
    min_predicted_iou: float = Field(0.8, ge=0, le=1)
    """least quality the mask believes it has"""
    min_stability: float = Field(0.95, ge=0, le=1)
    """least overlap of the mask cut at logits +1 and -1"""
    max_box_overlap: float = Field(0.7, ge=0, le=1)
    """of two boxes that overlap more, the better stays"""


class SamSegmenter(Segmenter):
    """All but how words are read.

    With `prompt` set, `propose` returns only what the words name.
    """

    image_class: ClassVar[str]  # of transformers: answers points and boxes
    video_class: ClassVar[str]  # follows objects
    session: ClassVar[str]  # module:class of what that one remembers
    mean: ClassVar[tuple[float, float, float]]  # of the training images, sRGB
    std: ClassVar[tuple[float, float, float]]
    threshold_key: ClassVar[str]  # the setting to lower where words are not found

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

    @abstractmethod
    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...]: ...

    @remembered
    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        if self.settings.prompt:
            return self._named(image, self.settings.prompt)
        size = size_of(image)
        model = self._model(self.image_class, image.device)
        with torch.no_grad(), self._memory("segmenting"):
            found = self._candidates(model, self._embed(model, image), size)
            return tuple(
                proposal(enlarge(logits[None], size)[0], iou) for logits, iou in found
            )

    @remembered
    def segment_marks(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> Proposal:
        points, box = [*marks.inside, *marks.negative], box_of(marks)
        model = self._model(self.image_class, image.device)
        on = [True] * len(marks.inside) + [False] * len(marks.negative)
        prompts = self._prompts(model, points, on, box)
        # one point may mean a part or the whole: ask for all three
        ambiguous = (len(points) == 1 and box is None) or marks.larger != 0
        with torch.no_grad(), self._memory("segmenting"):
            output = model(
                image_embeddings=self._embed(model, image),
                multimask_output=ambiguous,
                **prompts,
            )
            areas = (output.pred_masks[0, 0] > 0).sum((1, 2)).tolist()
            best = int(output.iou_scores[0, 0].argmax())
            best = stepped(areas, best, marks.larger)
            small = output.pred_masks[0, 0, best : best + 1]
            logits = enlarge(small, size_of(image))[0]
        return proposal(logits, float(output.iou_scores[0, 0, best]))

    def ask(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[tuple[tuple[float, float], bool]],
        box: tuple[float, float, float, float] | None = None,
        before: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Its three masks for clicks (and whether the object is there) and a box, and for the
        logits `[h, w]` of an answer `before`, which cover the image.

        Returns logits `[3, h, w]` at the network's own resolution, which cover the image, and
        their predicted IoU `[3]`.
        """
        model = self._model(self.image_class, image.device)
        places, on = [place for place, _ in clicks], [inside for _, inside in clicks]
        prompts = self._prompts(model, places, on, box)
        if before is not None:
            mask = torch.from_numpy(np.float32(before))[None, None]
            prompts["input_masks"] = mask.to(model.device, model.dtype)
        with torch.no_grad(), self._memory("segmenting"):
            output = model(image_embeddings=self._embed(model, image), **prompts)
        logits, quality = output.pred_masks[0, 0], output.iou_scores[0, 0]
        return logits.float().numpy(force=True), quality.float().numpy(force=True)

    def _prompts(
        self,
        model: Any,
        points: Sequence[tuple[float, float]],
        on: Sequence[bool],
        box: tuple[float, float, float, float] | None,
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

    def _named(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...]:
        found = self.segment_text(image, text)
        if not found:
            raise PromptError(
                f"segmenter.prompt: {text!r} was not found on the picture; name it in other "
                "words, lower "
                f"{self.threshold_key}, or give masks with --mask."
            )
        return found

    def _candidates(
        self, model: Any, embeddings: list[Tensor], image_size: tuple[int, int]
    ) -> list[tuple[Float[Tensor, "h w"], float]]:
        """Ask for three masks at every point of a grid; keep the sure and stable ones that no
        better one covers.

        Returns small logits and predicted IoU in [0, 1] of each, best first.
        """
        chosen = self.settings
        grid = pixel_grid(
            (chosen.points_per_side, chosen.points_per_side), like=embeddings[0]
        ).flatten(0, 1)
        points = grid * model.config.prompt_encoder_config.image_size
        found = []
        for some in points.split(chosen.points_per_batch):
            output = model(
                image_embeddings=embeddings,
                input_points=some[None, :, None],
                multimask_output=True,
            )
            logits, iou = (
                output.pred_masks[0].flatten(0, 1),
                output.iou_scores[0].flatten(),
            )
            logits, iou = (
                values[iou >= chosen.min_predicted_iou] for values in (logits, iou)
            )
            large = enlarge(logits, image_size)
            stable = (stability(large) >= chosen.min_stability) & (large > 0).flatten(
                1
            ).any(1)
            # Only the small logits are kept: large masks of all points would fill the memory.
            found.append(
                (logits[stable], iou[stable].clamp(0, 1), boxes_of(large[stable] > 0))
            )
            progress(
                "segmenting",
                min(len(found) * chosen.points_per_batch, len(points)),
                len(points),
            )
        logits, iou, boxes = (torch.cat(parts) for parts in zip(*found))
        return [
            (logits[index], float(iou[index]))
            for index in best_boxes(boxes, iou, chosen.max_box_overlap)
        ]

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
            "try a smaller --set segmenter.points_per_batch, a smaller segmenter.model, or "
            "segmenter.device=cpu",
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
            logits.append(enlarge(output.pred_masks[:, 0], size))
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
    threshold_key = "segmenter.detector.box_threshold"

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
    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...]:
        height, width = image.shape[-2:]
        boxes = [detection.box for detection in self.detector.detect(image, text)]
        return tuple(
            self.segment(image, box=(x / width, y / height, w / width, h / height))
            for x, y, w, h in boxes
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
    threshold_key = "segmenter.min_score"

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
    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...]:
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
        masks = enlarge(found.pred_masks[0, best], size_of(image)).to(image.device)
        return tuple(
            proposal(mask, float(scores[index]))
            for mask, index in zip(masks, best)
            if bool((mask > 0).any())
        )


def proposal(logits: Float[Tensor, "height width"], predicted_iou: float) -> Proposal:
    """Make one mask at the photo's size a proposal."""
    inside = logits > 0
    area, stable, iou = (
        float(inside.float().mean()),
        float(stability(logits[None])),
        min(max(predicted_iou, 0.0), 1.0),
    )
    return Proposal(
        logits.sigmoid(), area, stable, iou, tuple(boxes_of(inside[None])[0].tolist())
    )


def box_of(marks: Marks) -> tuple[float, float, float, float] | None:
    """The box of marks [shares of the sides]; else that around where it is expected."""
    if marks.box is not None or marks.prior is None:
        return marks.box
    height, width = marks.prior.shape
    x, y, across, down = as_proposal(marks.prior).box
    return (x / width, y / height, across / width, down / height) if across else None


def stability(logits: Float[Tensor, "n height width"]) -> Float[Tensor, "n"]:
    """IoU of the masks cut at +1 and at -1; the first lies inside the second. 0 for a mask that is
    empty at -1.
    """
    strict = (logits > STABILITY_OFFSET).sum((1, 2))
    loose = (logits > -STABILITY_OFFSET).sum((1, 2))
    return strict / loose.clamp(min=1)


def boxes_of(inside: Bool[Tensor, "n height width"]) -> Float[Tensor, "n 4"]:
    """Smallest box around each mask: x, y, width, height [pixels]; zeros for an empty one."""
    boxes = [cv2.boundingRect(mask.byte().numpy(force=True)) for mask in inside]
    return torch.tensor(boxes, dtype=torch.float32).reshape(-1, 4)


def best_boxes(
    boxes: Float[Tensor, "n 4"], scores: Float[Tensor, "n"], overlap: float
) -> list[int]:
    """Non-maximum suppression: indices of boxes that no better one overlaps by more than `overlap`,
    best first.
    """
    if not len(boxes):
        return []
    # Scores are raised above its threshold, which drops boxes of score 0 otherwise.
    kept = cv2.dnn.NMSBoxes(
        boxes.tolist(),
        (1 + scores).tolist(),
        score_threshold=0.0,
        nms_threshold=overlap,
    )
    return [int(index) for index in kept]


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


def enlarge(
    logits: Float[Tensor, "*n h w"], size: tuple[int, int]
) -> Float[Tensor, "*n height width"]:
    """Resize the network's small masks to the photo's size; they stay logits."""
    flat = logits.flatten(0, -3)[:, None]
    large = F.interpolate(flat.float(), size, mode="bilinear", align_corners=False)
    return large[:, 0].unflatten(0, logits.shape[:-2])
