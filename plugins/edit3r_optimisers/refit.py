"""The reconstructor `refit`: reconstruct, edit, refit."""

from typing import Literal

import torch
from pydantic import Field

from edit3r.types import Cameras, Gaussians
from edit3r_optimisers.edits import edited
from edit3r_optimisers.fitting import FixedPictures
from edit3r_optimisers.method import FittingMethod
from edit3r_optimisers.renders import rendered
from edit3r_optimisers.scenes import Scene
from edit3r_optimisers.settings import MethodSettings

__all__ = ["RefitReconstructor"]


class RefitReconstructor(FittingMethod):
    """Fits Gaussians to the unedited photos, then goes on with edited pictures of the same cameras.

    The edited pictures are the views it is given, or its own renders of the photos' cameras put through the editor.
    Nothing makes the edits agree but the one scene they are fitted by.
    """

    class Settings(MethodSettings):
        edit: Literal["given", "renders"] = Field(
            "given", description="fit the edited photos it is given, or edit renders of the fitted scene"
        )

    @torch.no_grad()
    def _scene(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        workshop = self.workshop()
        gaussians, cameras = workshop.fit_photos(scene)
        if self.settings.edit == "renders":
            images = edited(self.editor, rendered(gaussians, cameras, scene.photos, self.rasterizer), scene.request)
            gaussians = workshop.fit_edits(gaussians, cameras, FixedPictures(images.images[0]))
        elif scene.is_edited:
            gaussians = workshop.fit_edits(gaussians, cameras, FixedPictures(scene.edited.images[0]))
        workshop.checkpoints.discard()
        return gaussians, cameras
