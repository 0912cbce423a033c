"""A finished run in memory: what is written, and what `RunResult` shows."""

from dataclasses import dataclass, field

from edit3r.contract.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.contract.reporting import Report
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict, Verdict
from edit3r.kit.cache import Cache
from edit3r.running.config import RunConfig
from edit3r.running.parts import Parts
from edit3r.running.records import Masks, Records


@dataclass(frozen=True, repr=False)
class RunRecord:
    """The records of a run's steps, and what made them."""

    records: Records = field(repr=False)
    parts: Parts
    report: Report
    cache: Cache  # answers that a further run on the same photos need not compute again

    @property
    def config(self) -> RunConfig:
        return self.parts.config

    @property
    def photos(self) -> Views:
        """The views that were used and placed, unedited."""
        return self.records.inputs.photos

    @property
    def edited(self) -> Views:
        """The views after the 2D editor and the composite with the masks."""
        return self.records.edit.views

    @property
    def masks(self) -> Masks | None:
        """Where pixels might change; None: everywhere."""
        return self.records.made.masks

    @property
    def gaussians(self) -> Gaussians:
        """The edited scene, in the frame of view 0."""
        return self.records.gaussians

    @property
    def cameras(self) -> Cameras:
        """Poses of the input views in that frame, at the views' size."""
        return self.records.made.cameras.at(self.photos.image_size)

    @property
    def rendered(self) -> Rendering:
        """The scene from the input views."""
        return self.records.judged.rendered

    @property
    def verdict(self) -> Verdict:
        """Whether the scene holds."""
        return self.records.judged.verdict

    @property
    def edit_verdict(self) -> EditVerdict | None:
        """How the edit was carried out on what was selected; None where none was asked for."""
        return self.records.judged.edit_verdict

    @property
    def selection_verdict(self) -> SelectionVerdict | None:
        """What was selected and how likely it is what was meant; None: nothing was looked for."""
        return self.records.selection.verdict

    @property
    def editor(self) -> Editor:
        return self.parts.editor

    @property
    def reconstructor(self) -> Reconstructor:
        return self.parts.reconstructor

    @property
    def rasterizer(self) -> Rasterizer:
        return self.parts.rasterizer
