"""Masks that `edit3r recolor` made of a real scene, cut as training cuts its photos."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from edit3r_recolor.api import MASKS, RECIPE, SceneRecipe
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.cameras import PosedCamera
from edit3r.io.decode import read_image
from edit3r.io.framing import frame_for
from edit3r.io.posed_folder import PosedFolder, undistorted


@dataclass(frozen=True)
class RegionMasks:
    """The result of one scene."""

    folder: Path

    def scene_with_masks(self, scene: PosedFolder) -> PosedFolder:
        """Only the photos that were used: in the others the objects may well be seen, but where is not known."""
        used = {view.name for view in self._recipe().views if view.processed}
        cameras = tuple(camera for camera in scene.cameras if Path(camera.file).stem in used)
        if not cameras:
            raise InputError(f"{self.folder}: holds masks of none of the photos of {scene.path}.")
        return replace(scene, cameras=cameras)

    def load(self, cameras: Sequence[PosedCamera], size: int) -> Float[Tensor, "object view size size"]:
        """Soft masks of every object on the centred squares of these photos; zero where an object is not seen."""
        numbers = [region.id for region in self._recipe().regions]
        return torch.stack([torch.stack([self._mask(n, camera, size) for camera in cameras]) for n in numbers])

    def _mask(self, number: int, camera: PosedCamera, size: int) -> Float[Tensor, "size size"]:
        file = self.folder / MASKS / str(number) / f"{Path(camera.file).stem}.png"
        if not file.is_file():
            return torch.zeros(size, size)
        mask = undistorted(read_image(file).convert("L"), camera)
        cut = frame_for((mask.height, mask.width), (size, size)).cut(mask, Image.Resampling.BILINEAR)
        return torch.from_numpy(np.asarray(cut, np.float32) / 255)

    def _recipe(self) -> SceneRecipe:
        return SceneRecipe.load(self.folder / RECIPE)
