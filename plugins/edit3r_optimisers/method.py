"""What a method is made of, the same for all four: settings, a first reconstruction, the editor, the rasterizer."""

from abc import abstractmethod

from edit3r.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.types import Cameras, EditRequest, Gaussians, Reconstruction, Views
from edit3r_optimisers.scenes import Scene, Workshop, each_scene
from edit3r_optimisers.settings import MethodSettings

__all__ = ["FittingMethod"]


class FittingMethod(Reconstructor):
    """A reconstructor that fits Gaussians scene by scene; a method fills in `_scene`."""

    def __init__(
        self, settings: MethodSettings, reconstructor: Reconstructor, editor: Editor, rasterizer: Rasterizer
    ) -> None:
        self.settings, self.reconstructor = settings, reconstructor
        self.editor, self.rasterizer = editor, rasterizer

    def __call__(self, views: Views, source: Views | None = None, request: EditRequest | None = None) -> Reconstruction:
        return each_scene(self.settings, views, source, request, self._scene)

    def workshop(self) -> Workshop:
        """The tools of one scene's fits."""
        return Workshop(self.settings, self.reconstructor, self.editor, self.rasterizer)

    @abstractmethod
    def _scene(self, scene: Scene) -> tuple[Gaussians, Cameras]:
        """The edited scene, and its cameras in the frame of view 0."""
