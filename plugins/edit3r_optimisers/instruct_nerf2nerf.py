"""The reconstructor `instruct-nerf2nerf`: images are edited one after the other while the scene is
fitted to them.

Instruct-NeRF2NeRF's iterative dataset update (Haque et al. 2023, section 4.2): every few steps a
view is rendered, noised, and denoised with the unedited photo as condition; the result replaces the
view's image.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from pydantic import Field, model_validator

from edit3r.contract.interfaces import Editor, Rasterizer
from edit3r.contract.reporting import note
from edit3r.contract.types import Cameras, EditRequest, Gaussians, Views
from edit3r_optimisers.fitting import TargetImages, view_at
from edit3r_optimisers.method import EditJob, FittingMethod, MethodSettings, edited_from


class InstructNerf2NerfReconstructor(FittingMethod):
    """Fits Gaussians instead of a NeRF, and edits by itself: of what it is given it looks at the
    unedited photos only.

    Real partial denoising needs an editor that can start from a picture (instruct-pix2pix); others
    are mixed in, which the run says.
    """

    class Settings(MethodSettings):
        edit_every: int = Field(10, ge=1)
        """steps between edits (paper: 10)"""
        least_strength: float = Field(0.5, ge=0, le=1)
        """least share of a render that an edit redraws"""
        most_strength: float = Field(0.98, ge=0, le=1)
        """most share of a render that an edit redraws"""

        @model_validator(mode="after")
        def _ordered(self) -> "InstructNerf2NerfReconstructor.Settings":
            if self.least_strength > self.most_strength:
                raise ValueError(
                    f"least_strength ({self.least_strength}) must not be above most_strength "
                    f"({self.most_strength})"
                )
            return self

    settings: Settings

    def _reconstruct(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        gaussians, cameras = self._fit_photos(scene)
        targets = DatasetUpdate(
            scene.photos,
            cameras,
            scene.request,
            self.settings,
            self.editor,
            self.rasterizer,
        )
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
        self.photos = photos
        self.cameras = cameras
        self.request = request
        self.settings = settings
        self.editor, self.rasterizer = editor, rasterizer
        self.updates = 0

    def before_step(self, step: int, scene: Callable[[], Gaussians]) -> None:
        if step % self.settings.edit_every == 0:
            self._update(scene())

    @torch.no_grad()
    def _update(self, gaussians: Gaussians) -> None:
        """Edit the next view, starting from how the scene shows it now, by a seed of its own."""
        view = [view_at(self.updates, self.photos.count, self.request.seed)]
        start = self.rasterizer.render(gaussians, self.cameras.select(view)).images
        seed, photo = self.request.seed + self.updates, self.photos.select(view)
        request = replace(self.request.of_views(view), seed=seed)
        answer = edited_from(self.editor, photo, start, request, self._strength())
        self.images[view] = answer.images[0]
        self.updates += 1

    def _strength(self) -> float:
        """Draw the strength evenly between the limits, by seed and number of the edit."""
        number = self.request.seed * 1_000_003 + self.updates
        generator = torch.Generator().manual_seed(number)
        least, most = self.settings.least_strength, self.settings.most_strength
        return least + (most - least) * float(torch.rand((), generator=generator))
