"""What may be asked of `edit3r evaluate`."""

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

    reconstructor: PartChoice
    """what is measured (default edit3r)"""
    matcher: PartChoice
    """reads the geometry that it uses, if any (default that of a run)"""
    rasterizer: PartChoice
    """draws the images (default auto)"""
    pairs: int = Field(6, ge=1)
    """most pairs of photos a folder (and class of overlap), 5 to 30 degrees apart; scenes of a data
    set
    """
    size: int = Field(256, ge=16)
    """side of the square the photos are cut and resized to [pixels]"""
    edits: bool = False
    """on data sets that know a true edit: how it is carried and fused, instead of novel views"""
    index: str = ""
    """pairs of an evaluation index file, by NoPoSplat's protocol"""
    align: int = Field(100, ge=0)
    """with --index: steps that align a target with its photo, 0 for none; input cameras take twice
    as many
    """
    lpips: bool = False
    """with --index: LPIPS, not the perceptual distance that is offline"""
    out: str = ""
    """write the table (.md) or every pair's figures (.json) here"""


class Evaluation(EvaluateOptions):
    """All that is asked for."""

    folders: tuple[str, ...]  # or names of data sets
    dataset: dict[str, Any] = Field(default_factory=dict)  # settings of data sets
