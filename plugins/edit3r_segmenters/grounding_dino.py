"""Grounding DINO (Liu et al. 2024): boxes of what a text names."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import Detection, Detector
from edit3r.contract.reporting import note
from edit3r.kit.weights.load import (
    ChosenWeights,
    foreign,
    identity,
    load_pretrained,
    out_of_memory_told,
    pick_device,
    sized,
)
from edit3r_segmenters import GROUNDING_DINO, GROUNDING_DINO_TINY, OF_HUB


class GroundingDinoDetector(Detector):
    """Open-vocabulary detection; several things are named as "a door. a chair."."""

    class Settings(edit3r.Settings):
        model: str = Field(
            default_factory=partial(sized, GROUNDING_DINO, GROUNDING_DINO_TINY)
        )
        """model id on the hub, or a saved folder; where none is given the tiny one for a CPU, the
        base one for a GPU or where only that was fetched
        """
        revision: str = ""
        """branch, tag or commit of the model; empty: the newest"""
        local_files_only: bool = False
        """never download"""
        device: str = "auto"
        """cpu, cuda, ...; auto: where the photos are (--device)"""
        box_threshold: float = Field(0.35, ge=0, le=1)
        """least score of a box"""
        text_threshold: float = Field(0.25, ge=0, le=1)
        """least score of a word that labels a box"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._loaded: tuple[Any, Any] | None = None

    def detect(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Detection, ...]:
        question = as_question(text)
        model, processor = self._model(image.device)
        pixels = (
            (image.detach().cpu().float().clamp(0, 1) * 255)
            .round()
            .byte()
            .permute(1, 2, 0)
            .numpy()
        )
        inputs = processor(images=pixels, text=question, return_tensors="pt").to(
            model.device
        )
        with (
            torch.no_grad(),
            out_of_memory_told(
                "looking for " + question, "use --set detector.device=cpu"
            ),
        ):
            outputs = model(**inputs)
        height, width = image.shape[-2:]
        found = processor.post_process_grounded_object_detection(
            outputs,
            inputs.input_ids,
            threshold=self.settings.box_threshold,
            text_threshold=self.settings.text_threshold,
            target_sizes=[(height, width)],
        )[0]
        labels = [
            without(processor.tokenizer.all_special_tokens, label)
            for label in found["text_labels"]
        ]
        return ranked(labels, found["scores"], found["boxes"], (height, width))

    def _model(self, photos_on: torch.device) -> tuple[Any, Any]:
        if self._loaded is None:
            chosen = self.settings
            weights = ChosenWeights(
                chosen.model,
                "detector.model",
                chosen.revision,
                local_files_only=chosen.local_files_only,
                known=OF_HUB,
            )
            model = load_pretrained(
                foreign("transformers", "GroundingDinoForObjectDetection"),
                weights,
                dtype=torch.float32,
            )
            device = pick_device(chosen.device, photos_on, "detector.device")
            processor = load_pretrained(
                foreign("transformers", "GroundingDinoProcessor"), weights
            )
            self._loaded = model.to(device).eval(), processor
            note("detector.weights", identity(weights))
        return self._loaded


def as_question(text: str) -> str:
    """The form the network was trained on: lower case, every name closed by a full stop."""
    question = " ".join(text.lower().split())
    if not question:
        raise PromptError(
            "the detector was asked for nothing; name an object such as 'the bike'."
        )
    return question if question.endswith(".") else f"{question}."


def without(special_tokens: Iterable[str], label: str) -> str:
    """A label's words only: with a low text threshold the separators score too."""
    for token in special_tokens:
        label = label.replace(token, " ")
    return " ".join(label.split()).strip(" .")


def ranked(
    labels: list[str],
    scores: Float[Tensor, "n"],
    boxes: Float[Tensor, "n 4"],
    size: tuple[int, int],
) -> tuple[Detection, ...]:
    """Make detections inside an image of `size` from corner boxes (x0, y0, x1, y1) [pixels], best
    first.
    """
    height, width = size
    corners = (
        boxes.cpu()
        .clamp(min=0)
        .minimum(torch.tensor([width, height, width, height]).to(boxes.cpu()))
    )
    found = [
        Detection(label, float(score), (x0, y0, x1 - x0, y1 - y0))
        for label, score, (x0, y0, x1, y1) in zip(labels, scores, corners.tolist())
        if x1 > x0 and y1 > y0
    ]
    return tuple(sorted(found, key=lambda detection: -detection.score))
