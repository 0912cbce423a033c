"""What the four methods share: one scene at a time, a fit to the photos, edits within the masks, a
fit to the edits.
"""

from abc import abstractmethod
from copy import copy
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import (
    Editor,
    EditsViews,
    Geometry,
    Rasterizer,
    Reconstructor,
    StartsFromImages,
    StartsFromScene,
)
from edit3r.contract.reporting import note, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import (
    Cameras,
    EditRequest,
    Gaussians,
    GivenScene,
    Reconstruction,
    Views,
)
from edit3r.kit import asking
from edit3r.kit.geometry.maps import composite
from edit3r.kit.geometry.pose import estimate_cameras
from edit3r.kit.rendering import CheckedRasterizer, OverBackground
from edit3r.running import instructions_for
from edit3r_optimisers.fitting import FitSettings, TargetImages, fit

# a fainter first Gaussian has next to no gradient and would never show its worth; no figure kept
VISIBLE_OPACITY = 0.05


class MethodSettings(FitSettings):
    """A fit of the photos, edits, and a fit of the edits."""

    reconstructor: PartChoice = PartChoice(name="classical")
    """where the first Gaussians come from"""
    editor: PartChoice = PartChoice(name="recolor")
    """edits; in a run, the run's own takes its place"""
    rasterizer: PartChoice = PartChoice(name="auto")
    """renders while fitting"""
    prompt: str = ""
    """what to change; in a run, the run's own takes its place"""
    points: int = Field(10_000, ge=1)
    """most Gaussians to begin with; a reconstruction is thinned to them"""
    steps: int = Field(300, ge=1, le=1_000_000)
    """steps of the fit to the photos"""
    edit_steps: int = Field(300, ge=1, le=1_000_000)
    """steps of the fit to the edits"""


@dataclass(frozen=True)
class EditJob:
    """One scene (batch 1) to edit."""

    photos: Views  # unedited
    edited: Views  # as the caller's editor made them; the photos themselves where it edited nothing
    request: EditRequest
    geometry: Geometry | None  # of the photos; None: the reconstructor uses none

    @property
    def is_edited(self) -> bool:
        return not torch.equal(self.photos.images, self.edited.images)


class FittingMethod(Reconstructor, EditsViews, StartsFromScene):
    """Fits Gaussians scene by scene and edits in between; a method fills in `_reconstruct`.

    A given scene is begun with as it is, as published; no photos are fitted then.
    """

    settings: MethodSettings
    given: GivenScene | None = None

    def __init__(
        self,
        settings: MethodSettings,
        reconstructor: Reconstructor,
        editor: Editor,
        rasterizer: Rasterizer,
    ) -> None:
        self.settings, self.reconstructor = settings, reconstructor
        self.editor, self.rasterizer = editor, CheckedRasterizer(rasterizer)
        self.uses_geometry = reconstructor.uses_geometry

    def starting_from(self, scene: GivenScene) -> "FittingMethod":
        started = copy(self)
        started.given, started.uses_geometry = scene, False
        started.rasterizer = OverBackground(self.rasterizer, scene.background)
        return started

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        """Reconstruct every scene of the batch by itself; prompt and seed are the settings' own."""
        prompt = self.settings.prompt
        instructions = instructions_for(self.editor, prompt)
        request = EditRequest(prompt, self.settings.seed, instructions=instructions)
        return self.edit_and_reconstruct(
            views, views if source is None else source, request, geometry
        )

    @torch.no_grad()
    def edit_and_reconstruct(
        self,
        views: Views,
        source: Views,
        request: EditRequest,
        geometry: Geometry | None = None,
    ) -> Reconstruction:
        photos = source
        if photos.c2w is None and views.c2w is not None:
            photos = replace(photos, c2w=views.c2w)
        results = []
        for item in range(len(views.images)):
            scene = EditJob(
                photos.scene(item),
                views.scene(item),
                request.of_scene(item),
                None if geometry is None else geometry.scene(item),
            )
            results.append(self._reconstruct(scene))
        scenes, cameras = zip(*results)
        c2w = torch.cat([one.c2w for one in cameras])
        intrinsics = torch.cat([one.intrinsics for one in cameras])
        gaussians = scenes[0] if len(scenes) == 1 else Gaussians.stack(scenes)
        size = cameras[0].image_size
        return Reconstruction(gaussians, Cameras(c2w, intrinsics, size))

    @abstractmethod
    def _reconstruct(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        """Return the edited scene, and its cameras in the frame of view 0."""

    def _fit_photos(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        """Fit the unedited scene; returns it and its cameras in the frame of view 0.

        A given one is fitted already.
        """
        if self.given is not None:
            note("refit.given_gaussians", self.given.gaussians.count)
            return self.given.gaussians, self.given.cameras
        chosen, photos = self.settings, TargetImages(scene.photos.images[0])
        start, cameras = begin(scene, self.reconstructor, chosen.points, chosen.seed)
        return self._fit("photos", start, cameras, photos), cameras

    def _fit(
        self, what: str, start: Gaussians, cameras: Cameras, targets: TargetImages
    ) -> Gaussians:
        """Fit the "photos" or the "edits", beginning at `start`."""
        chosen = self.settings
        steps = chosen.steps if what == "photos" else chosen.edit_steps
        text, render = f"fit to the {what}", self.rasterizer
        fitted = fit(start, cameras, targets, render, chosen, steps, text)
        losses = fitted.losses[:10], fitted.losses[-10:]
        first, last = (round(sum(part) / len(part), 5) for part in losses)
        count = {"steps": steps, "gaussians": fitted.gaussians.count}
        note(f"refit.{what}", {**count, "first_loss": first, "last_loss": last})
        return fitted.gaussians


def begin(
    scene: EditJob, reconstructor: Reconstructor, most: int, seed: int
) -> tuple[Gaussians, Cameras]:
    """Return at most `most` first Gaussians of one scene's unedited photos (batch 1), and the
    photos' cameras.

    Both are in view 0's frame. Raises MatchingError where the reconstructor cannot place the
    photos.
    """
    photos = scene.photos
    answer = asking.reconstruct(
        reconstructor, photos, lambda: reconstructor(photos, photos, scene.geometry)
    )
    every = answer.gaussians
    cameras = answer.cameras or estimate_cameras(every, photos, answer.per_pixel)
    gaussians = thinned(every.select(every.opacities[0] > 0), most, seed)
    note("refit.first_gaussians", gaussians.count)
    opacities = gaussians.opacities.clamp(min=VISIBLE_OPACITY)
    return replace(gaussians, opacities=opacities), cameras


def thinned(gaussians: Gaussians, most: int, seed: int) -> Gaussians:
    """At most `most` Gaussians by chance, widened so that they still cover their surfaces."""
    if gaussians.count <= most:
        return gaussians
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(gaussians.count, generator=generator)
    chosen = gaussians.select(order[:most].sort().values.to(gaussians.means.device))
    return replace(chosen, scales=chosen.scales * (gaussians.count / most) ** 0.5)


@torch.no_grad()
def edited(editor: Editor, views: Views, request: EditRequest) -> Views:
    """The edited views, held to the editor's contract and confined to the request's masks."""
    answer = asking.edit(editor, views, request)
    return _confined(views, answer, request)


@torch.no_grad()
def edited_from(
    editor: Editor,
    views: Views,
    start: Float[Tensor, "batch view 3 height width"],
    request: EditRequest,
    strength: float,
) -> Views:
    """Edit `views`, beginning from the images `start`; `strength` in [0, 1] says how little of them
    stays.

    An editor that cannot begin from images edits anew, and its result is mixed with them; the run
    says so.
    """
    if isinstance(editor, StartsFromImages):
        answer = asking.edit_from(editor, views, start, request, strength)
        return _confined(views, answer, request)
    warn(
        f"editor {component_name(editor)!r} cannot start from a given picture, so each new edit is "
        "mixed with it: a stand-in for the partial denoising of the published method."
    )
    anew = edited(editor, views, request)
    mixed = torch.lerp(start.clamp(0, 1), anew.images, strength)
    return _confined(views, replace(views, images=mixed), request)


def _confined(views: Views, answer: Views, request: EditRequest) -> Views:
    """The editor's answer inside the request's masks."""
    if request.masks is None:
        return replace(views, images=answer.images)
    return replace(views, images=composite(views.images, answer.images, request.masks))


@torch.no_grad()
def rendered(
    gaussians: Gaussians, cameras: Cameras, photos: Views, rasterizer: Rasterizer
) -> Views:
    """Return the views as the fitted scene shows them."""
    images = rasterizer.render(gaussians, cameras).images.clamp(0, 1)
    return replace(photos, images=images, c2w=cameras.c2w)


@torch.no_grad()
def depths_of(
    gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer
) -> tuple[Float[Tensor, "view height width"], Float[Tensor, "view height width"]]:
    """Return camera z of every pixel of one scene, and its alpha.

    Where a pixel shows nothing, z is the farthest depth of that view.
    """
    seen = rasterizer.render(gaussians, cameras)
    depths, alphas = seen.depths[0, :, 0], seen.alphas[0, :, 0]
    farthest = depths.amax((1, 2), keepdim=True).clamp(min=1e-6)
    return torch.where(depths > 0, depths, farthest), alphas
