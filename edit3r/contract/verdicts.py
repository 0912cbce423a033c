"""The three answers at the end of a run: what was selected, how the edit was carried out on it, and
whether the scene holds. Critics give the last two; the first is what a selector says.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Label = Literal["good", "fair", "poor", "failed"]
LABELS: tuple[Label, ...] = ("good", "fair", "poor", "failed")
"""Of scenes, best first."""
Part = Literal["geometry", "reconstructor", "refiner", "rasterizer", "editor", "photos"]
"""Of a run, that may be to blame for a scene."""
EditLabel = Literal["good", "doubtful"]
SelectionLabel = Literal["given", "found", "question"]


@dataclass(frozen=True)
class SelectionVerdict:
    """What was selected, and how likely it is what was meant. It says nothing of the edit."""

    # given: marked exactly or confirmed; question: a person should look at it
    label: SelectionLabel
    reason: str  # what was selected; of a question, how to answer it too
    confidence: float | None  # in [0, 1] that it is what was meant; None: it was given
    # what `--candidate` takes instead, the likeliest first
    candidates: tuple[int, ...] = ()

    @property
    def short(self) -> str:
        """The label, and how confident."""
        if self.confidence is None:
            return self.label
        return f"{self.label}, confidence {self.confidence:.0%}"

    def __str__(self) -> str:
        return f"{self.label}, {self.reason}"


@dataclass(frozen=True)
class Verdict:
    """The label of a run, why, and the figures behind it; lists have one entry a photo."""

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
    # how much of that picture looks like neither of the two views; None: not known
    unlike_between: tuple[float | None, ...]
    # how many times as unlike the view its nearest one is, laid onto it by the scene's depths and
    # poses, as by those of the run's geometry; 1: the scene is as good; None: not known
    beside_geometry: tuple[float | None, ...] = ()
    # the same of the run's geometry (of the scene, where there is none) beside one flat picture
    # (homography); 1: it has no depth; None: not known, or the photos show a plane
    beside_flat: tuple[float | None, ...] = ()
    # how much more of the view half-way looks like no photo than of the cheapest scene of that
    # geometry, one Gaussian a pixel, in [-1, 1]; None: not known
    beside_reference: tuple[float | None, ...] = ()
    # that is to blame; None: the scene is good, or nobody knows
    part: Part | None = None


@dataclass(frozen=True)
class EditVerdict:
    """How the edit was carried out on what was selected: the label, why, and figures."""

    label: EditLabel
    reason: str  # what is doubtful, in one sentence; what was measured where nothing is
    measures: Mapping[str, Any]  # figures by name, which the critic explains

    def __str__(self) -> str:
        return f"{self.label}, {self.reason}"
