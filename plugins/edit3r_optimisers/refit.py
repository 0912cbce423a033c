"""The reconstructor `refit`: reconstruct, edit, refit."""

from edit3r.contract.types import Cameras, Gaussians
from edit3r_optimisers.fitting import TargetImages
from edit3r_optimisers.method import EditJob, FittingMethod, MethodSettings


class RefitReconstructor(FittingMethod):
    """Fits Gaussians to the unedited photos, then goes on with edited images of the same cameras.

    The edited images are the views it is given. Nothing makes them agree but the one scene they are
    fitted by.
    """

    Settings = MethodSettings

    def _reconstruct(self, scene: EditJob) -> tuple[Gaussians, Cameras]:
        gaussians, cameras = self._fit_photos(scene)
        if not scene.is_edited:
            return gaussians, cameras
        targets = TargetImages(scene.edited.images[0])
        return self._fit("edits", gaussians, cameras, targets), cameras
