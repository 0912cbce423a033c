"""The one state of a run: what is known of the scene so far."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.contract.wishes import Wish
from edit3r.kit.geometry.light import Light
from edit3r.kit.photos.images import Photo
from edit3r.running.judging.edit_verdict import EditVerdict
from edit3r.running.judging.verdict import Verdict
from edit3r.running.selecting.select import Selected, Selection


def known_cameras(reconstruction: Reconstruction) -> Cameras:
    """The cameras of a checked reconstruction, which has them whether predicted or by PnP."""
    assert reconstruction.cameras is not None
    return reconstruction.cameras


NOT_YET: Any = None
"""What a later step fills in."""


@dataclass(frozen=True)
class Scene:
    """What a run knows. Each step returns a new one with more of it filled in.

    After `reconstruct` only the placed views are in it; `placed` tells which they are.
    """

    photos: Views  # unedited; geometry is read from them
    start: Views  # what the edit is applied to: the photos, or an earlier run's edited views
    records: tuple[Photo, ...] = ()  # how files became the photos; () where none did
    mask_files: Mapping[str, str] = field(default_factory=dict)  # file: sha256
    prompts: tuple[str, ...] = ()  # the edits so far, this run's last
    marked: Selection | None = None  # what the user marked on the photos
    # in [0, 1]; 1: may change; None: everywhere
    masks: Float[Tensor, "batch view height width"] | None = None
    # where each wish of the prompt applies, in [0, 1]
    regions: Float[Tensor, "wish batch view height width"] | None = None
    # the sentence as it was read, with colours that were read off the photos
    wishes: tuple[Wish, ...] = ()
    selected: tuple[
        Selected, ...
    ] = ()  # the things that were looked for, of the first scene
    # masks of what was named, in this run and before; of the first scene
    things: Mapping[str, Float[Tensor, "view height width"]] = field(
        default_factory=dict
    )
    edited: Views = NOT_YET  # after the 2D editor and the composite with the masks
    # how the photos' colours become the first one's; None: they are taken as they are
    light: Light | None = None
    # what one photo alone shows where others see through its place; None: nothing
    passing: Bool[Tensor, "batch view height width"] | None = None
    # share of the picture half-way to the nearest photo that nobody measured; None: not known
    guessed: Float[Tensor, "batch view"] | None = None
    # nobody knows the lens, and all that the photos share lies on one plane
    flat: bool = False
    # fields of view [degrees] that explain the photos alike, where they do not tell their lens
    lenses: tuple[float, float] | None = None
    # the scene as it was before this edit, where somebody needs it
    before: Reconstruction | None = None
    reconstruction: Reconstruction = NOT_YET  # of the edited views
    placed: tuple[
        bool, ...
    ] = ()  # for each view that was used; False: left out of the scene
    left_out: Views | None = None  # photos that could not be placed
    gaussians: Gaussians = NOT_YET  # after the refiners, in the frame of view 0
    rendered: Rendering = NOT_YET  # the Gaussians from the input views
    verdict: Verdict = NOT_YET  # on the scene
    edit_verdict: EditVerdict | None = None  # None: no edit was asked for

    @property
    def cameras(self) -> Cameras:
        """Poses of the input views in the Gaussians' frame, at the views' size."""
        return known_cameras(self.reconstruction).at(self.start.image_size)

    @property
    def confined(self) -> bool:
        """Whether some pixels must stay as they are."""
        return self.masks is not None and not bool((self.masks > 0).all())

    def in_one_light(self, views: Views) -> Views:
        """Photos of this scene, edited or not, as they would look in the first one's light."""
        if self.light is None:
            return views
        return replace(views, images=self.light.to_reference(views.images))

    def select(self, indices: list[int]) -> "Scene":
        """The same with the views at `indices` only; nothing has been reconstructed yet."""
        if indices == list(range(self.photos.count)):
            return self
        records = tuple(self.records[i] for i in indices) if self.records else ()
        return replace(
            self,
            photos=self.photos.select(indices),
            start=self.start.select(indices),
            records=records,
            masks=None if self.masks is None else self.masks[:, indices],
            regions=None if self.regions is None else self.regions[:, :, indices],
            things={name: masks[indices] for name, masks in self.things.items()},
            edited=None if self.edited is None else self.edited.select(indices),
            light=None if self.light is None else self.light.select(indices),
            passing=None if self.passing is None else self.passing[:, indices],
            guessed=None if self.guessed is None else self.guessed[:, indices],
        )

    def to(self, device: torch.device | str) -> "Scene":
        """The same with its tensors on `device`."""
        moved = {
            name: value.to(device)
            for name in ("photos", "start", "masks", "before")
            if (value := getattr(self, name)) is not None
        }
        return replace(self, **moved)
