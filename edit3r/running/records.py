"""What each step of a run knows when it is done: one frozen record a step (run.json: `run_json`).

    read      locate     select      edit      correct     reconstruct      refine       judge
    Inputs -> Located -> Selected -> Edited -> Exposure -> Reconstructed -> Gaussians -> Judged
                         Regions     Photos    Corrected
Views that a reconstructor does not take, or cannot place, leave the records by `select`. Lengths
are in the run's own unit (`edit3r.running.unit`); what is written is in the given one, or in
metres (`edit3r.running.measuring`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.instructions import Instruction
from edit3r.contract.interfaces import Geometry, Selected, Selection
from edit3r.contract.types import (
    Cameras,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
    along,
)
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict, Verdict
from edit3r.kit.geometry.cameras import relative_to_first
from edit3r.kit.geometry.exposure import Exposure, ExposureOfEdit
from edit3r.kit.photos.images import Photo
from edit3r.running.geometry import NOT_ASKED, GeometryAnswer
from edit3r.running.scene_input import SceneInput
from edit3r.running.selecting.verdict import MARKED, verdict_on_selection
from edit3r.running.unit import GIVEN, Direction, KnownLength, KnownLevel, Unit

Masks = Float[Tensor, "batch view height width"]
"""In [0, 1]; 1: may change."""


def is_confined(masks: Masks | None) -> TypeGuard[Masks]:
    """Whether masks leave some pixels as they are."""
    return masks is not None and not bool((masks > 0).all())


READ_LENS = "read from the photos"
"""How the remark begins on a lens that nobody told."""


@dataclass(frozen=True)
class Inputs:
    """The photos, what is marked on them, and what an earlier run left."""

    photos: Views  # unedited; geometry is read from them
    start: Views  # what the edit is applied to: the photos, or an earlier run's edited views
    files: tuple[Photo, ...] = ()  # how files became the photos; () where none did
    mask_files: Mapping[str, str] = field(default_factory=dict)  # file: sha256
    prompts: tuple[str, ...] = ()  # the edits so far, this run's last
    marked: Selection | None = None  # what the user marked on the photos
    masks: Masks | None = None  # given ones
    # masks of what earlier runs named, in [0, 1]; of the first scene
    things: Mapping[str, Float[Tensor, "view height width"]] = field(
        default_factory=dict
    )
    before: Reconstruction | None = None  # an earlier run's scene
    scene: SceneInput | None = None  # the given one that the photos are pictures of
    unit: Unit = GIVEN  # what lengths were multiplied by
    length: KnownLength | None = None  # between two places of the photos
    level: KnownLevel | None = None  # places of the photos at one height
    # by what all lengths of the result are multiplied, so that they are in metres; 1: nobody knows
    scale: float = 1.0
    # what points up in the frame of view 0: the result is turned so that it is -y; None: it is not
    up: Direction | None = None

    def select(self, indices: list[int]) -> "Inputs":
        """The same with the views at `indices` only."""
        return along(
            self,
            "view",
            indices,
            photos=self.photos.select(indices),
            start=self.start.select(indices),
            files=tuple(self.files[i] for i in indices) if self.files else (),
            things={name: masks[indices] for name, masks in self.things.items()},
        )

    def unmeasured(self) -> "Inputs":
        """A finished run's, in the unit and frame before a known length and a known up; these are
        kept, for the edit that goes on from it.
        """
        back, before = GIVEN.times(self.scale).upright(self.up).inverse, self.before
        if before is not None:
            before = back.reconstruction(before)
        if before is not None and before.cameras is not None and self.up is not None:
            # view 0 is exactly the identity
            c2w = relative_to_first(before.cameras.c2w)
            before = replace(before, cameras=replace(before.cameras, c2w=c2w))
        return replace(
            self,
            photos=back.views(self.photos),
            start=back.views(self.start),
            before=before,
        )

    def to(self, device: torch.device | str) -> "Inputs":
        """The same with its tensors on `device`."""
        return replace(
            self,
            photos=self.photos.to(device),
            start=self.start.to(device),
            masks=None if self.masks is None else self.masks.to(device),
            before=None if self.before is None else self.before.to(device),
        )


@dataclass(frozen=True)
class Located:
    """What the photos tell before anything is edited; nothing where no part uses geometry."""

    # of the photos as they were taken; the one owner of the run's geometry
    answer: GeometryAnswer = NOT_ASKED
    # the same with depth measured in one exposure, where that makes a difference
    corrected: Geometry | None = None
    # nobody knows the lens, and all that the photos share lies on one plane
    flat: bool = False
    # fields of view [degrees] that explain the photos alike, where they do not tell their lens
    fov_range: tuple[float, float] | None = None
    # how the photos' colours become the first one's; None: they are taken as they are
    exposure: Exposure | None = None

    @property
    def geometry(self) -> Geometry | None:
        """Of the photos as they were taken."""
        return self.answer.geometry

    @property
    def to_build_on(self) -> Geometry | None:
        """The geometry that the scene is made on."""
        return self.geometry if self.corrected is None else self.corrected

    def select(self, indices: list[int]) -> "Located":
        """The same with the views at `indices` only."""
        corrected, exposure = self.corrected, self.exposure
        return replace(
            self,
            answer=self.answer.select(indices),
            corrected=None if corrected is None else corrected.select(indices),
            exposure=None if exposure is None else exposure.select(indices),
        )


@dataclass(frozen=True)
class SelectedRegions:
    """Which pixels may change."""

    masks: Masks | None = None  # None: everywhere
    # where each instruction of the prompt applies, in [0, 1]
    regions: Float[Tensor, "instruction batch view height width"] | None = None
    # the sentence as it was read, with colours that were read off the photos
    instructions: tuple[Instruction, ...] = ()
    # the things that were looked for, of the first scene
    selected: tuple[Selected, ...] = ()
    # somebody saw the candidates and took one of them (`--candidate`)
    chosen: bool = False
    # masks of what was named, in this run and before; of the first scene
    things: Mapping[str, Float[Tensor, "view height width"]] = field(
        default_factory=dict
    )

    @property
    def verdict(self) -> SelectionVerdict | None:
        """What was selected and how likely it is what was meant; None: nothing was looked for."""
        said = dict.fromkeys(str(one.target) for one in self.instructions)
        exactly = "; ".join(said) or MARKED
        exactly = exactly if self.confined else ""
        return verdict_on_selection(self.selected, exactly, self.chosen)

    @property
    def confined(self) -> bool:
        """Whether some pixels must stay as they are."""
        return is_confined(self.masks)

    def select(self, indices: list[int]) -> "SelectedRegions":
        """The same with the views at `indices` only."""
        return along(
            self,
            "view",
            indices,
            selected=tuple(one.select(indices) for one in self.selected),
            things={name: masks[indices] for name, masks in self.things.items()},
        )


@dataclass(frozen=True)
class EditedPhotos:
    """The 2D edit, held to the masks."""

    views: Views
    # what shows that pictures are no edits of their photos
    faults: tuple[str, ...] = ()
    moved: tuple[str, ...] = ()  # what was undone of pictures that had moved
    verdict: EditVerdict | None = None  # in 2D; None: no edit was asked for

    def select(self, indices: list[int]) -> "EditedPhotos":
        """The same with the views at `indices` only."""
        return replace(self, views=self.views.select(indices))


@dataclass(frozen=True)
class ExposureCorrected:
    """The photos before and after the edit as the scene shows them: in the first one's exposure."""

    photos: Views
    edited: Views
    # how the edited photos' colours became the first one's; None: as they are
    exposure: Exposure | ExposureOfEdit | None = None

    def select(self, indices: list[int]) -> "ExposureCorrected":
        """The same with the views at `indices` only."""
        exposure = self.exposure
        return ExposureCorrected(
            self.photos.select(indices),
            self.edited.select(indices),
            None if exposure is None else exposure.select(indices),
        )

    def undone(self, rendering: Rendering) -> Rendering:
        """The edited scene from the photos' places, in the exposure in which each was taken."""
        if self.exposure is None:
            return rendering
        return replace(rendering, images=self.exposure.to_own(rendering.images))


@dataclass(frozen=True)
class Reconstructed:
    """The edited views in 3D; all but `placed` and `photos` are of the placed views alone."""

    reconstruction: Reconstruction
    photos: Views  # all that were used
    placed: tuple[bool, ...]  # for each of them; False: left out of the scene
    # where the scene may change; None: everywhere
    masks: Masks | None = None
    # the scene as it was before this edit, where a refiner needs it
    before: Reconstruction | None = None

    @property
    def cameras(self) -> Cameras:
        """Of the placed views, at the size of the reconstruction."""
        return known_cameras(self.reconstruction)

    @property
    def used(self) -> list[int]:
        """Indices of the placed views."""
        return [view for view, there in enumerate(self.placed) if there]

    @property
    def left_out(self) -> Views | None:
        """Photos that could not be placed."""
        lost = [view for view, there in enumerate(self.placed) if not there]
        return self.photos.select(lost) if lost else None


@dataclass(frozen=True)
class Judged:
    """The finished scene from the photos' places, and what critics say."""

    rendered: Rendering
    verdict: Verdict
    edit_verdict: EditVerdict | None  # None: no edit was asked for


@dataclass(frozen=True)
class Preview:
    """What is selected and, if that was asked for, how it is edited, without any scene."""

    inputs: Inputs
    selection: SelectedRegions
    edit: EditedPhotos | None


@dataclass(frozen=True)
class Records:
    """What each step of a finished run returned."""

    inputs: Inputs
    located: Located
    selection: SelectedRegions
    edit: EditedPhotos
    corrected: ExposureCorrected
    reconstructed: Reconstructed
    gaussians: Gaussians  # after the refiners, in the frame of view 0
    judged: Judged


def known_cameras(reconstruction: Reconstruction) -> Cameras:
    """The cameras of a checked reconstruction, which has them whether predicted or by PnP."""
    assert reconstruction.cameras is not None
    return reconstruction.cameras
