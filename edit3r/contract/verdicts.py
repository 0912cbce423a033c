"""What critics say of a run: of its scene, and of its edit."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Label = Literal["good", "fair", "poor", "failed"]
LABELS: tuple[Label, ...] = ("good", "fair", "poor", "failed")
"""Of scenes, best first."""
EditLabel = Literal["good", "doubtful"]


@dataclass(frozen=True)
class Verdict:
    """The label of a run, why, and the figures behind it; the lists have one entry for each photo
    used, in order.
    """

    label: Label
    reason: str  # one sentence that says what was found and what to do
    # [dB] of each view's rendering against its edited image; None: left out
    input_psnr: tuple[float | None, ...]
    # [dB] the same before any refiner: how well the photos' geometry fits together
    agreement: tuple[float | None, ...]
    placed: tuple[bool, ...]  # False: the photo could not be placed and is left out
    # share of the view's pixels that show Gaussians, in [0, 1]
    coverage: tuple[float | None, ...]
    # share of the view's pixels whose depth was guessed; None: not known
    filled: tuple[float | None, ...]
    # share of the picture half-way to the nearest view whose depth was guessed; None: not known
    guessed_between: tuple[float | None, ...]


@dataclass(frozen=True)
class EditVerdict:
    """The label of an edit, why, and the figures behind it."""

    label: EditLabel
    reason: str  # what is doubtful, in one sentence; what was measured where nothing is
    # how surely words or a guess found the thing, in [0, 1]; 0: a guess; None: it was marked
    confidence: float | None
    measures: Mapping[str, Any]  # figures by name, which the critic explains

    def __str__(self) -> str:
        return f"{self.label}, {self.reason}"
