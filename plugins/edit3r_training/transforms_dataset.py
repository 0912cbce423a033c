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

from edit3r.errors import InputError
from edit3r.io.cameras import CAMERA_FILES, PosedCamera
from edit3r.io.decode import read_image
from edit3r.io.framing import frame_for
from edit3r.io.posed_folder import PosedFolder, read_posed_folder
from edit3r_training.photo_dataset import (
    DrawnPhotos,
    PhotoDataset,
    PhotoSettings,
    choose_by_angle,
    choose_by_gap,
)


class TransformsDataset(PhotoDataset):
    """Folders with photos and a camera file."""

    name = "transforms"

    class Settings(PhotoSettings):
        root: str = Field(description="folder that holds scene folders, at any depth")
        samples: int = Field(100, ge=1, description="draws per scene")
        targets: int = Field(2, ge=0, le=16, description="novel views")
        select: Literal["angle", "gap"] = Field(
            "angle", description="choose views by angle, or by gap in the sequence"
        )
        angles: tuple[float, float] = Field(
            (5.0, 30.0), description="between neighbouring context views [degrees]"
        )
        gap: tuple[int, int] = Field(
            (5, 22), description="from first to last context view [frames]"
        )
        masks: str = Field(
            "",
            description="folder with what `edit3r recolor` wrote for each scene, under the "
            "scene's name; empty: none",
        )

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
        photos, cameras = zip(
            *(
                (folder.load(view, chosen.image_size), folder.cameras[view])
                for view in views
            )
        )
        return DrawnPhotos(
            folder.name,
            torch.from_numpy(np.stack([p.image for p in photos]))
            .permute(0, 3, 1, 2)
            .contiguous(),
            torch.from_numpy(np.stack([p.c2w for p in photos])),
            torch.from_numpy(np.stack([p.intrinsics for p in photos])).float(),
            None if regions is None else regions.masks(cameras, chosen.image_size),
        )

    def _choose(
        self, folder: PosedFolder, rng: np.random.Generator, gap: tuple[int, int]
    ) -> list[int] | None:
        """Indices of the context views, then of the targets; None when the photos do not fit."""
        chosen = self.settings
        if chosen.select == "gap":
            return choose_by_gap(
                rng, len(folder.cameras), chosen.context, chosen.targets, gap
            )
        c2w = np.stack([camera.c2w for camera in folder.cameras])
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
        """Only the photos that were used: the others may well show the objects, but where is not
        known.
        """
        used = {view.name for view in self.recipe.views if view.processed}
        cameras = tuple(
            camera for camera in folder.cameras if Path(camera.file).stem in used
        )
        if not cameras:
            raise InputError(
                f"{self.path}: holds masks of none of the photos of {folder.path}."
            )
        return replace(folder, cameras=cameras)

    def masks(
        self, cameras: Sequence[PosedCamera], size: int
    ) -> Float[Tensor, "object view size size"]:
        """Soft masks of every object on the centred squares of these photos; zero where an object
        is not seen.
        """
        numbers = [region.id for region in self.recipe.regions]
        return torch.stack(
            [
                torch.stack([self._mask(n, camera, size) for camera in cameras])
                for n in numbers
            ]
        )

    def _mask(
        self, number: int, camera: PosedCamera, size: int
    ) -> Float[Tensor, "size size"]:
        """The mask of one object in one photo."""
        file = self.path / MASKS / str(number) / f"{Path(camera.file).stem}.png"
        if not file.is_file():
            return torch.zeros(size, size)
        mask = read_image(file).convert("L")
        frame = frame_for((mask.height, mask.width), (size, size)).through(camera.lens)
        cut = frame.cut(mask, Image.Resampling.BILINEAR)
        return torch.from_numpy(np.asarray(cut, np.float32) / 255)
