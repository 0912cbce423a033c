"""The reconstructor `instruct-nerf2nerf`: images are edited one after the other while the scene is fitted to them.

Instruct-NeRF2NeRF's iterative dataset update (Haque et al. 2023, section 4.2): every few steps a view is rendered,
noised, and denoised with the unedited photo as condition; the result replaces the view's image.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from pydantic import Field, model_validator

from edit3r.interfaces import Editor, Rasterizer
from edit3r.reporting import note
from edit3r.types import Cameras, EditRequest, Gaussians, Views
from edit3r_optimisers.edits import edited_from
from edit3r_optimisers.fitting import TargetImages, view_at
from edit3r_optimisers.method import FittingMethod, MethodSettings, Scene


class InstructNerf2NerfReconstructor(FittingMethod):
    """Updates the images one after the other while Gaussians, instead of a NeRF, are fitted (Haque et al. 2023).

    It edits by itself: the edited views it is given are not looked at, only the photos before editing. Real partial
    denoising needs an editor that can start from a picture (instruct-pix2pix); others are mixed in, which the run says.
    """

    class Settings(MethodSettings):
        every: int = Field(10, ge=1, description="steps between edits (paper: 10)")
        views_at_once: int = Field(1, ge=1, description="views edited each time (paper: 1)")
        least_strength: float = Field(0.5, ge=0, le=1, description="least share of a render that an edit redraws")
        most_strength: float = Field(0.98, ge=0, le=1, description="most share of a render that an edit redraws")
        fresh_noise: bool = Field(True, description="another seed for every edit, as published")

        @model_validator(mode="after")
        def _ordered(self) -> "InstructNerf2NerfReconstructor.Settings":
            if self.least_strength > self.most_strength:
                raise ValueError(
                    f"least_strength ({self.least_strength}) must not be above most_strength ({self.most_strength})"
                )
            return self

    def _reconstruct(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        gaussians, cameras = self._fit_photos(scene)
        targets = DatasetUpdate(scene.photos, cameras, scene.request, self.settings, self.editor, self.rasterizer)
        gaussians = self._fit("edits", gaussians, cameras, targets)
        note("refit.edits_of_the_dataset", targets.updates)
        return gaussians, cameras


class DatasetUpdate(TargetImages):
    """Target images that start as the photos and are edited anew; `updates` counts the edits."""

    def __init__(
        self,
        photos: Views,
        cameras: Cameras,
        request: EditRequest,
        settings: InstructNerf2NerfReconstructor.Settings,
        editor: Editor,
        rasterizer: Rasterizer,
    ) -> None:
        super().__init__(photos.images[0].clone())
        self.photos, self.cameras, self.request, self.settings = photos, cameras, request, settings
        self.editor, self.rasterizer = editor, rasterizer
        self.updates = 0

    def before_step(self, step: int, scene: Callable[[], Gaussians]) -> None:
        if step % self.settings.every == 0:
            self._update(scene())

    @torch.no_grad()
    def _update(self, gaussians: Gaussians) -> None:
        """Edit the next views, starting from how the scene shows them now."""
        count = min(self.settings.views_at_once, self.photos.count)
        first = self.updates * count
        # A round of all views may begin and end within one update; a view is edited once then.
        views = list(dict.fromkeys(view_at(first + k, self.photos.count, self.request.seed) for k in range(count)))
        start = self.rasterizer.render(gaussians, self.cameras.select(views)).images
        request = self.request.of_views(views)
        if self.settings.fresh_noise:
            request = replace(request, seed=self.request.seed + self.updates)
        answer = edited_from(self.editor, self.photos.select(views), start, request, self._strength())
        self.images[views] = answer.images[0]
        self.updates += 1

    def _strength(self) -> float:
        """Draw the strength evenly between the limits, by seed and number of the edit."""
        generator = torch.Generator().manual_seed(self.request.seed * 1_000_003 + self.updates)
        least, most = self.settings.least_strength, self.settings.most_strength
        return least + (most - least) * float(torch.rand((), generator=generator))
