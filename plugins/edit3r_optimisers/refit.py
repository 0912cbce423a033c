"""The reconstructor `refit`: reconstruct, edit, refit."""

from typing import Literal

from edit3r.contract.types import Cameras, Gaussians
from edit3r_optimisers.fitting import TargetImages
from edit3r_optimisers.method import (
    EditJob,
    FittingMethod,
    MethodSettings,
    edited,
    rendered,
)


class RefitReconstructor(FittingMethod):
    """Fits Gaussians to the unedited photos, then goes on with edited images of the same cameras.

    The edited images are the views it is given, or its own renders of the photos' cameras put
    through the editor. Nothing makes the edits agree but the one scene they are fitted by.
    """

    class Settings(MethodSettings):
        edit: Literal["given", "renders"] = "given"
        """fit the edited photos it is given, or edit renders of the fitted scene"""

    settings: Settings

    def _reconstruct(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        gaussians, cameras = self._fit_photos(scene)
        if self.settings.edit == "renders":
            shown = rendered(gaussians, cameras, scene.photos, self.rasterizer)
            views = edited(self.editor, shown, scene.request)
        elif scene.is_edited:
            views = scene.edited
        else:
            return gaussians, cameras
        targets = TargetImages(views.images[0])
        return self._fit("edits", gaussians, cameras, targets), cameras
