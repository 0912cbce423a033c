"""What `edit3r evaluate` is asked."""

from typing import Any

from pydantic import Field

from edit3r.contract.settings import PartChoice, Settings
from edit3r.running import DEFAULTS

PARTS = {
    "reconstructor": "edit3r",
    "matcher": DEFAULTS["matcher"],
    "rasterizer": "auto",
}


class EvaluateOptions(Settings):
    """What is measured, and how."""

    reconstructor: PartChoice = Field(description="what is measured (default edit3r)")
    matcher: PartChoice = Field(
        description="reads the geometry that it uses, if any (default that of a run)"
    )
    rasterizer: PartChoice = Field(description="draws the images (default auto)")
    pairs: int = Field(
        6,
        ge=1,
        description="most pairs of photos a folder (and class of overlap), 5 to 30 degrees "
        "apart; scenes of a data set",
    )
    size: int = Field(
        256,
        ge=16,
        description="side of the square the photos are cut and resized to [pixels]",
    )
    edits: bool = Field(
        False,
        description="on data sets that know a true edit: how it is carried and fused, instead "
        "of novel views",
    )
    index: str = Field(
        "", description="pairs of an evaluation index file, by NoPoSplat's protocol"
    )
    align: int = Field(
        100,
        ge=0,
        description="with --index: steps that align a target with its photo, 0 for none; input "
        "cameras take twice as many",
    )
    lpips: bool = Field(
        False,
        description="with --index: LPIPS, not the perceptual distance that is offline",
    )
    out: str = Field(
        "", description="write the table (.md) or every pair's figures (.json) here"
    )


class Evaluation(EvaluateOptions):
    """All that is asked for."""

    folders: tuple[str, ...]  # or names of data sets
    dataset: dict[str, Any] = Field(default_factory=dict)  # settings of data sets
