"""The reconstructor `gaussctrl` (Wu et al. 2024): renders are edited together, held by depth, and
fitted.
"""

from copy import copy

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import ConditionedOnDepth, Editor, Geometry, Matcher
from edit3r.contract.reporting import note, warn
from edit3r.contract.types import Cameras, EditRequest, Gaussians, Views
from edit3r_optimisers.fitting import TargetImages
from edit3r_optimisers.method import (
    EditJob,
    FittingMethod,
    MethodSettings,
    depths_of,
    edited,
    rendered,
)

ALIGNMENT = (
    "views are not aligned to reference views by attention, only the second fit "
    "makes them agree"
)
DEPTH = "edits are not conditioned on the fitted depth"
OPAQUE = 0.5  # alpha from which a pixel's depth is the scene's

Depths = Float[Tensor, "view height width"]


class FittedGeometry(Matcher):
    """Poses and depths of a fitted scene, for components that ask a matcher; it matches nothing."""

    def __init__(self, cameras: Cameras, depths: Depths, alphas: Depths) -> None:
        self.cameras, self.depths, self.alphas = cameras, depths, alphas

    def match(self, views: Views) -> Geometry:
        """Return the geometry of the views it was made for, whatever their images."""
        depths, count = self.depths, self.cameras.count
        registered = depths.new_ones(1, count, dtype=torch.bool)
        confidence = (self.alphas > OPAQUE).to(depths)
        return Geometry(self.cameras.c2w, depths[None], confidence[None], registered)


class GaussCtrlReconstructor(FittingMethod):
    """Depth and alignment are the editor's to use: `controlnet-depth` does both.

    With another editor the views are edited as that one edits, and the run says what is missing. It
    edits by itself: the edited views it is given are not looked at.
    """

    class Settings(MethodSettings):
        together: int = Field(12, ge=2)
        """most views edited in one call, the reference views among them; more need more memory"""

    settings: Settings

    # of the editor, to be given other depths; shares the weights
    _copy: Editor | None = None

    def _reconstruct(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        gaussians, cameras = self._fit_photos(scene)
        views = rendered(gaussians, cameras, scene.photos, self.rasterizer)
        geometry = depths_of(gaussians, cameras, self.rasterizer)
        images = self._edited(views, cameras, geometry, scene.request)
        return self._fit("edits", gaussians, cameras, TargetImages(images)), cameras

    def _edited(
        self,
        views: Views,
        cameras: Cameras,
        geometry: tuple[Depths, Depths],
        request: EditRequest,
    ) -> Float[Tensor, "view 3 height width"]:
        """Edit all views, a few at a time, the reference views first in every call."""
        self._warn_of_missing_abilities()
        together = self.settings.together
        wanted = min(_references(self.editor), together - 1)
        references = reference_views(views.count, wanted)
        images = views.images[0].clone()
        for chunk in chunks(views.count, references, together):
            depths, alphas = (maps[chunk] for maps in geometry)
            fitted = FittedGeometry(cameras.select(chunk), depths, alphas)
            editor = self._editor_with(fitted)
            answer = edited(editor, views.select(chunk), request.of_views(chunk))
            images[chunk] = answer.images[0]
        return images

    def _editor_with(self, geometry: FittedGeometry) -> Editor:
        """The editor with the fitted scene as matcher; as it is where it reads no depth."""
        if not isinstance(self.editor, ConditionedOnDepth):
            return self.editor
        if self._copy is None:
            self._copy = copy(self.editor)
        assert isinstance(self._copy, ConditionedOnDepth)  # as the editor is
        self._copy.matcher = geometry
        return self._copy

    def _warn_of_missing_abilities(self) -> None:
        name = component_name(self.editor)
        conditioned = isinstance(self.editor, ConditionedOnDepth)
        aligns = _references(self.editor) > 0
        facts = {"aligns_views": aligns, "depth_of_the_fit": conditioned}
        note("gaussctrl.editor", {"name": name, **facts})
        done = {ALIGNMENT: aligns, DEPTH: conditioned}
        missing = [text for text, is_done in done.items() if not is_done]
        if missing:
            warn(
                f"gaussctrl with editor {name!r}: {' and '.join(missing)}; editor "
                "'controlnet-depth' does both."
            )


def reference_views(count: int, wanted: int) -> list[int]:
    """Choose `wanted` of `count` views, spread evenly; [] for none."""
    places = torch.linspace(0, count - 1, min(wanted, count))
    return sorted(set(places.round().long().tolist()))


def chunks(count: int, references: list[int], together: int) -> list[list[int]]:
    """Calls of at most `together` views that edit every view once, after the references."""
    others = [view for view in range(count) if view not in references]
    room = max(1, together - len(references))
    parts = [others[at : at + room] for at in range(0, len(others), room)] or [[]]
    return [[*references, *part] for part in parts]


def _references(editor: Editor) -> int:
    """How many views all others look at while the editor works; 0: each is edited by itself."""
    return editor.references if isinstance(editor, ConditionedOnDepth) else 0
