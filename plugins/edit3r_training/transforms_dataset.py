"""Dataset `transforms`: folders of photos with a nerfstudio `transforms.json` (DL3DV's layout) or a
`cameras.json`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from edit3r_recolor.api import MASKS, RECIPE, SceneRecipe
from jaxtyping import Float
from PIL import Image
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.settings import Count
from edit3r.kit.photos.camera_files import CAMERA_FILES, PosedCamera
from edit3r.kit.photos.decode import read_image
from edit3r.kit.photos.framing import frame_for
from edit3r.kit.photos.posed_folder import PosedFolder, read_posed_folder
from edit3r_training.photo_dataset import (
    DrawnPhotos,
    PhotoDataset,
    PhotoSettings,
    choose_by_angle,
    choose_by_gap,
)
from edit3r_training.spans import CountSpan, Span


class TransformsDataset(PhotoDataset):
    """Folders with photos and a camera file."""

    name = "transforms"

    class Settings(PhotoSettings):
        root: str
        """folder that holds scene folders, at any depth"""
        samples: Count = 100
        """draws per scene"""
        targets: int = Field(2, ge=0, le=16)
        """novel views"""
        select: Literal["angle", "gap"] = "angle"
        """choose views by angle, or by gap in the sequence"""
        angles: Span = (5.0, 30.0)
        """between neighbouring context views [degrees]"""
        gap: CountSpan = (5, 22)
        """from first to last context view [frames]"""
        masks: str = ""
        """folder with what `edit3r recolor` wrote for each scene, under the scene's name; empty:
        none
        """
        edits: str = ""
        """folder with an editor's image of every photo, SCENE/PHOTO.png or .jpg, for the regimes
        viewwise and generated; empty: none
        """

    settings: Settings

    @cached_property
    def scenes(self) -> list[Path]:
        """Every folder under the root that has a camera file, sorted."""
        root = Path(self.settings.root)
        found = sorted(
            {path.parent for name in CAMERA_FILES for path in root.rglob(name)}
        )
        if not found:
            raise InputError(f"{root}: no {' or '.join(CAMERA_FILES)} in it or below.")
        return found

    def _label(self, scene: Path) -> str:
        return f"scene {scene.name}"

    def _draw(
        self, scene: Path, rng: np.random.Generator, gap: tuple[int, int]
    ) -> DrawnPhotos:
        chosen, folder, regions = self.settings, read_posed_folder(scene), None
        if chosen.masks:
            regions = SceneRegions.read(Path(chosen.masks) / folder.name)
            folder = regions.photos_with_masks(folder)
        views = self._choose(folder, rng, gap)
        if views is None:
            raise InputError(
                f"{scene}: no {chosen.context} photos fit the {chosen.select} asked for."
            )
        size = chosen.image_size
        photos = [folder.load(view, size) for view in views]
        cameras = [folder.cameras[view] for view in views]
        edited = None
        if chosen.edits:
            edits = Path(chosen.edits) / folder.name
            edited = torch.stack([_edit_of(edits, camera, size) for camera in cameras])
        masks = None if regions is None else regions.masks(cameras, size)
        return DrawnPhotos.of(folder.name, photos, masks=masks, edited=edited)

    def _choose(
        self, folder: PosedFolder, rng: np.random.Generator, gap: tuple[int, int]
    ) -> list[int] | None:
        """Indices of the context views, then of the targets; None when the photos do not fit."""
        chosen = self.settings
        if chosen.select == "gap":
            return choose_by_gap(
                rng, len(folder.cameras), chosen.context, chosen.targets, gap
            )
        c2w = np.stack(folder.poses)
        return choose_by_angle(rng, c2w, chosen.context, chosen.targets, chosen.angles)


@dataclass(frozen=True)
class SceneRegions:
    """The masks that `edit3r recolor` made of one scene."""

    path: Path
    recipe: SceneRecipe

    @staticmethod
    def read(path: Path) -> "SceneRegions":
        """Read the folder that `edit3r recolor` wrote."""
        return SceneRegions(path, SceneRecipe.load(path / RECIPE))

    def photos_with_masks(self, folder: PosedFolder) -> PosedFolder:
        """Only the photos that were used: where others show the objects is not known."""
        used = {view.name for view in self.recipe.views if view.processed}
        cameras = tuple(
            camera for camera in folder.cameras if Path(camera.file).stem in used
        )
        if not cameras:
            raise InputError(
                f"{self.path}: holds no mask of any photo in {folder.path}."
            )
        return replace(folder, cameras=cameras)

    def masks(
        self, cameras: Sequence[PosedCamera], size: int
    ) -> Float[Tensor, "object view size size"]:
        """Soft masks of every object on these photos' squares; zero where it is not seen."""
        objects = [
            torch.stack([self._mask(region.id, camera, size) for camera in cameras])
            for region in self.recipe.regions
        ]
        return torch.stack(objects)

    def _mask(
        self, number: int, camera: PosedCamera, size: int
    ) -> Float[Tensor, "size size"]:
        """The mask of one object in one photo."""
        file = self.path / MASKS / str(number) / f"{Path(camera.file).stem}.png"
        if not file.is_file():
            return torch.zeros(size, size)
        return _cut(read_image(file).convert("L"), camera, size)


def _edit_of(
    folder: Path, camera: PosedCamera, size: int
) -> Float[Tensor, "3 size size"]:
    """The edited image of one photo, cut as the photo is; raises InputError where it is missing."""
    name = Path(camera.file).stem
    files = [folder / f"{name}{suffix}" for suffix in (".png", ".jpg")]
    present = [file for file in files if file.is_file()]
    if not present:
        raise InputError(f"{folder}: no edited image {name}.png or {name}.jpg in it.")
    return _cut(read_image(present[0]), camera, size).permute(2, 0, 1)


def _cut(image: Image.Image, camera: PosedCamera, size: int) -> Tensor:
    """The centred square of an image in [0, 1], without the lens distortion of its photo."""
    frame = frame_for((image.height, image.width), (size, size)).through(camera.lens)
    cut = frame.cut(image, Image.Resampling.BILINEAR)
    return torch.from_numpy(np.asarray(cut, np.float32) / 255)
