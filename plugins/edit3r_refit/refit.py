"""The reconstructor `refit`: reconstruct, edit, refit."""

from typing import Literal

import torch
from pydantic import Field

from edit3r.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.types import Cameras, EditRequest, Gaussians, Reconstruction, Views
from edit3r_refit.edits import edited
from edit3r_refit.fitting import FixedPictures
from edit3r_refit.renders import rendered
from edit3r_refit.scenes import Scene, Workshop, each_scene
from edit3r_refit.settings import MethodSettings

__all__ = ["RefitReconstructor"]


class RefitReconstructor(Reconstructor):
    """Fits Gaussians to the unedited photos, then goes on with edited pictures of the same cameras.

    The edited pictures are the views it is given, or its own renders of the photos' cameras put through the editor.
    Nothing makes the edits agree but the one scene they are fitted by.
    """

    class Settings(MethodSettings):
        edit: Literal["given", "renders"] = Field(
            "given", description="fit the edited photos it is given, or edit renders of the fitted scene"
        )

    def __init__(
        self, settings: Settings, reconstructor: Reconstructor, editor: Editor, rasterizer: Rasterizer
    ) -> None:
        self.settings, self.reconstructor = settings, reconstructor
        self.editor, self.rasterizer = editor, rasterizer

    def __call__(self, views: Views, source: Views | None = None, request: EditRequest | None = None) -> Reconstruction:
        return each_scene(self.settings, views, source, request, self._scene)

    @torch.no_grad()
    def _scene(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        workshop = Workshop(self.settings, self.reconstructor, self.editor, self.rasterizer)
        gaussians, cameras = workshop.fit_photos(scene)
        if self.settings.edit == "renders":
            images = edited(self.editor, rendered(gaussians, cameras, scene.photos, self.rasterizer), scene.request)
            gaussians = workshop.fit_edits(gaussians, cameras, FixedPictures(images.images[0]))
        elif scene.is_edited:
            gaussians = workshop.fit_edits(gaussians, cameras, FixedPictures(scene.edited.images[0]))
        workshop.checkpoints.discard()
        return gaussians, cameras
