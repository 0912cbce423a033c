"""What a run made, as a plain record: what is written, and what `RunResult` shows."""

from dataclasses import dataclass, field

from edit3r.contract.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.contract.reporting import Report
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.kit.cache import Cache
from edit3r.running.config import RunConfig
from edit3r.running.judging.edit_verdict import EditVerdict
from edit3r.running.judging.verdict import Verdict
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene


@dataclass(frozen=True, repr=False)
class RunRecord:
    """What a run made, in memory."""

    scene: Scene = field(repr=False)
    parts: Parts
    report: Report
    cache: Cache  # answers that a further run on the same photos need not compute again

    @property
    def config(self) -> RunConfig:
        return self.parts.config

    @property
    def photos(self) -> Views:
        """The views that were used and placed, unedited."""
        return self.scene.photos

    @property
    def edited(self) -> Views:
        """The views after the 2D editor and the composite with the masks."""
        return self.scene.edited

    @property
    def gaussians(self) -> Gaussians:
        """The edited scene, in the frame of view 0."""
        return self.scene.gaussians

    @property
    def cameras(self) -> Cameras:
        """Poses of the input views in that frame."""
        return self.scene.cameras

    @property
    def rendered(self) -> Rendering:
        """The scene from the input views."""
        return self.scene.rendered

    @property
    def verdict(self) -> Verdict:
        """How well the scene shows the edited images."""
        return self.scene.verdict

    @property
    def edit_verdict(self) -> EditVerdict | None:
        """How surely the edit is what was asked for; None where none was."""
        return self.scene.edit_verdict

    @property
    def editor(self) -> Editor:
        return self.parts.editor

    @property
    def reconstructor(self) -> Reconstructor:
        return self.parts.reconstructor

    @property
    def rasterizer(self) -> Rasterizer:
        return self.parts.rasterizer
