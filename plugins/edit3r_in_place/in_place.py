"""The reconstructor `in-place`: the edit goes into the scene that is there."""

from collections.abc import Sequence
from copy import copy

import torch
from jaxtyping import Bool, Float
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.interfaces import (
    EditsViews,
    FindsGeometry,
    Geometry,
    Rasterizer,
    Reconstructor,
    StartsFromScene,
)
from edit3r.contract.reporting import note
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import (
    EditRequest,
    Gaussians,
    GivenScene,
    Reconstruction,
    Views,
)
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.scenes.scene_views import SceneGeometry
from edit3r_in_place.belonging import SHARE, belonging, evidence, with_specks
from edit3r_in_place.colours import bounded, repainted, shine_of, solve_colours
from edit3r_in_place.filling import filled

LEAST = 1 / 255  # change of a picture [sRGB] that counts
LEFT = 0.05  # by eye: share of the pictures that a removal leaves, at least


class InPlaceReconstructor(Reconstructor, EditsViews, FindsGeometry, StartsFromScene):
    """Changes colours of the Gaussians that an edit shows on, and takes out what is removed.

    All else of the scene stays bit for bit. Needs a given scene.
    """

    class Settings(edit3r.Settings):
        rasterizer: PartChoice = PartChoice(name="auto")
        """renders the scene"""
        fill: bool = True
        """continue what surrounds a removed thing where nothing was seen behind it"""

    settings: Settings
    min_views = 1
    uses_geometry = True
    fuses_by_itself = True
    scene: GivenScene | None = None

    def __init__(self, settings: Settings, rasterizer: Rasterizer) -> None:
        super().__init__(settings)
        self.rasterizer = rasterizer

    def starting_from(self, scene: GivenScene) -> "InPlaceReconstructor":
        started = copy(self)
        started.scene = scene
        return started

    def find_geometry(self, views: Views) -> Geometry:
        """That of the scene itself, whatever the pictures show."""
        return SceneGeometry(self._given(views)).find_geometry(views)

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        scene = self._given(views)
        return _answer(scene, self._recoloured(scene, views.images[0]))

    def edit_and_reconstruct(
        self,
        views: Views,
        source: Views,
        request: EditRequest,
        geometry: Geometry | None = None,
    ) -> Reconstruction:
        """As pictures and request say: what is to be removed goes, all else changes colours."""
        scene = self._given(views)
        removals = [one.action == "remove" for one in request.instructions]
        if not any(removals):
            return self(views, source, geometry)
        gone = _removed(request, removals)
        chosen = self._chosen(scene, gone)
        _check_removal(scene, gone, chosen)
        chosen = with_specks(scene.gaussians, chosen)
        gaussians = scene.gaussians
        if not all(removals):
            wanted = torch.where(gone[:, None] > 0, scene.images[0], views.images[0])
            gaussians = self._recoloured(scene, wanted)
        kept = ~chosen
        rest = gaussians.select(kept)
        guesses = filled(scene, rest, self.rasterizer) if self.settings.fill else None
        facts = {"gaussians": int(chosen.sum())}
        if guesses is not None:
            facts["guessed"] = guesses.count
            rest = Gaussians.cat([rest, guesses])
        note("scene.removed", facts)
        return _answer(scene, rest, kept)

    def _given(self, views: Views) -> GivenScene:
        """The scene; raises InputError without one, and for views of something else."""
        if self.scene is None:
            raise InputError(
                "reconstructor 'in-place' edits a scene that is there; give a splat file in place "
                "of photos."
            )
        expected = self.scene.images.shape
        if views.images.shape != expected:
            raise InputError(
                f"reconstructor 'in-place': got views {list(views.images.shape)}, expected the "
                f"given scene's {list(expected)}."
            )
        return self.scene

    def _recoloured(
        self, scene: GivenScene, wanted: Float[Tensor, "view 3 height width"]
    ) -> Gaussians:
        change = wanted - scene.images[0]
        inside = (change.abs().amax(1) > LEAST) & (scene.alphas[0] > LEAST)
        if not bool(inside.any()):
            note("scene.changed", {"gaussians": 0, "mean_change": 0.0})
            return scene.gaussians
        change = change * inside[:, None]
        chosen = self._chosen(scene, inside.to(change))
        gaussians, cameras = scene.gaussians, scene.cameras
        added = solve_colours(gaussians, cameras, change, chosen, self.rasterizer)
        added = bounded(dc_to_colour(gaussians.harmonics[0, :, 0]), added)
        edited = repainted(gaussians, chosen, added)
        if gaussians.degree > 0:
            drawn = wanted - (1 - scene.alphas[0][:, None]) * scene.background
            shine = shine_of(edited, cameras, drawn, inside, chosen, self.rasterizer)
            edited.harmonics[0, chosen, 1:] = edited.harmonics[0, chosen, 1:] @ shine.T
        moved = float(added[chosen].abs().mean()) if bool(chosen.any()) else 0.0
        facts = {"gaussians": int(chosen.sum()), "mean_change": round(moved, 4)}
        note("scene.changed", facts)
        return edited

    def _chosen(
        self, scene: GivenScene, masks: Float[Tensor, "view height width"]
    ) -> Bool[Tensor, "gaussian"]:
        shown = evidence(scene.gaussians, scene.cameras, masks, self.rasterizer)
        return belonging(scene.gaussians, shown) > SHARE


def _removed(
    request: EditRequest, removals: Sequence[bool]
) -> Float[Tensor, "view height width"]:
    """Where the pictures show what is to go. Raises PromptError where nothing says it."""
    if request.regions is not None:
        return request.regions[torch.tensor(removals), 0].amax(0)
    if request.masks is None:
        raise PromptError("in-place: nothing says what is to be removed; click on it.")
    return request.masks[0]


def _check_removal(
    scene: GivenScene,
    masks: Float[Tensor, "view height width"],
    chosen: Bool[Tensor, "gaussian"],
) -> None:
    """Raise InputError where nothing is to go, or so much that hardly anything is left."""
    shown = scene.alphas[0]
    left = float((shown - masks).clamp(min=0).sum() / shown.sum())
    if bool(chosen.any()) and not bool(chosen.all()) and left > LEFT:
        return
    which = "all" if bool(chosen.any()) else "none"
    raise InputError(
        f"in-place: {which} of the scene would be removed; click on one thing of it, or take "
        "another candidate (--candidate 2)."
    )


def _answer(
    scene: GivenScene,
    gaussians: Gaussians,
    kept: Bool[Tensor, "gaussian"] | None = None,
) -> Reconstruction:
    if kept is None:
        kept = torch.ones(gaussians.count, dtype=torch.bool)
    measured = torch.ones(1, scene.cameras.count)
    return Reconstruction(
        gaussians, scene.cameras, measured=measured, per_pixel=0, kept=kept
    )
