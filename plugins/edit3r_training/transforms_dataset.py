"""Dataset `transforms`: folders of photos with a nerfstudio `transforms.json` (DL3DV's layout) or a `cameras.json`."""

from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from pydantic import Field

from edit3r import config, reporting
from edit3r.errors import InputError
from edit3r.interfaces import Dataset, SceneSample
from edit3r.io.cameras import CAMERA_FILES
from edit3r.io.posed_folder import PosedFolder, read_posed_folder
from edit3r_training.photo_samples import make_sample
from edit3r_training.region_masks import RegionMasks
from edit3r_training.view_sampling import ViewChoice, by_angle, by_gap


class TransformsDataset(Dataset):
    """One sample is one draw of views from one scene; a scene that cannot be used is skipped and named once."""

    class Settings(config.Settings):
        root: str = Field(description="folder that holds scene folders, at any depth")
        samples: int = Field(100, ge=1, description="draws per scene")
        seed: int = Field(0, ge=0, description="of view choice and mirroring")
        image_size: int = Field(256, ge=16, le=1024, description="side of the centred square [pixels]")
        context: int = Field(2, ge=2, le=16, description="input views")
        targets: int = Field(2, ge=0, le=16, description="novel views")
        select: Literal["angle", "gap"] = Field("angle", description="choose views by angle, or by gap in the sequence")
        angles: tuple[float, float] = Field((5.0, 30.0), description="between neighbouring context views [degrees]")
        gap: tuple[int, int] = Field((5, 22), description="from first to last context view [frames]")
        mirror: float = Field(0.5, ge=0, le=1, description="share of samples mirrored left to right")
        masks: str = Field(
            "",
            description="folder with what `edit3r recolor` wrote for each scene, under the scene's name; empty: none",
        )

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._broken: set[str] = set()

    @cached_property
    def folders(self) -> list[Path]:
        """Every folder under the root that has a camera file, sorted."""
        root = Path(self.settings.root)
        found = sorted({path.parent for name in CAMERA_FILES for path in root.rglob(name)})
        if not found:
            raise InputError(f"{root}: no {' or '.join(CAMERA_FILES)} in it or below.")
        return found

    def __len__(self) -> int:
        return len(self.folders) * self.settings.samples

    def __getitem__(self, index: int) -> SceneSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        for attempt in range(len(self.folders)):
            folder = self.folders[(index + attempt) % len(self.folders)]
            try:
                return self._sample(folder, index)
            except InputError as error:
                self._skip(folder, str(error))
        raise InputError(f"{self.settings.root}: none of its {len(self.folders)} scenes can be used.")

    def _skip(self, folder: Path, reason: str) -> None:
        if folder.name not in self._broken:
            self._broken.add(folder.name)
            reporting.warn(f"dataset transforms: scene {folder.name} is skipped ({len(self._broken)} so far): {reason}")

    def _sample(self, folder: Path, index: int) -> SceneSample:
        scene = read_posed_folder(folder)
        regions = RegionMasks(Path(self.settings.masks) / scene.name) if self.settings.masks else None
        if regions is not None:
            scene = regions.scene_with_masks(scene)
        rng = np.random.default_rng((self.settings.seed, index))
        choice = self._choose(scene, rng)
        if choice is None:
            raise InputError(f"{folder}: no {self.settings.context} photos fit the {self.settings.select} asked for.")
        views = (*choice.context, *choice.target)
        size = self.settings.image_size
        photos = [scene.load(view, size) for view in views]
        return make_sample(
            torch.from_numpy(np.stack([p.image for p in photos])).permute(0, 3, 1, 2).contiguous(),
            torch.from_numpy(np.stack([p.c2w for p in photos])),
            torch.from_numpy(np.stack([p.intrinsics for p in photos])).float(),
            self.settings.context,
            f"{scene.name}-{index}",
            rng,
            self.settings.mirror,
            None
            if regions is None
            else regions.load([scene.cameras[view] for view in views], self.settings.image_size),
        )

    def _choose(self, scene: PosedFolder, rng: np.random.Generator) -> ViewChoice | None:
        chosen = self.settings
        if chosen.select == "gap":
            return by_gap(rng, len(scene.cameras), chosen.context, chosen.targets, chosen.gap)
        c2w = np.stack([camera.c2w for camera in scene.cameras])
        return by_angle(rng, c2w, chosen.context, chosen.targets, chosen.angles)
