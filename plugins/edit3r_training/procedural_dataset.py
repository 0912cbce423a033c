"""Dataset `procedural`: endless random scenes, each a function of (seed, index)."""

from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from edit3r_recolor.api import recolored, visible_parameters
from pydantic import Field

from edit3r import config
from edit3r.geometry.cameras import intrinsics_from_fov
from edit3r.interfaces import Dataset, SceneSample
from edit3r.types import Cameras
from edit3r_training.procedural.raycaster import CastPicture, cast
from edit3r_training.procedural.scene import Scene, random_scene
from edit3r_training.procedural.textures import texture_bank
from edit3r_training.procedural.trajectory import random_cameras

_EIGHT_BITS = ("context", "target", "context_masks", "target_masks", "edited_context", "edited_target")
EDITS = ("recolor", "add", "remove", "global")


class ProceduralDataset(Dataset):
    """Textured rooms and open grounds with many objects; exact poses, depth, masks and edited truth."""

    class Settings(config.Settings):
        scenes: int = Field(100_000, ge=1, description="number of samples")
        seed: int = Field(0, ge=0, description="two seeds share no scene")
        image_size: int = Field(64, ge=8, le=1024, description="height and width of the pictures [pixels]")
        context: int = Field(2, ge=1, le=16, description="input views")
        targets: int = Field(2, ge=0, le=16, description="novel views")
        angles: tuple[float, float] = Field(
            (4.0, 30.0), description="least and most angle between input views [degrees]"
        )
        objects: tuple[int, int] = Field((5, 16), description="least and most objects besides the room")
        outdoor: float = Field(0.35, ge=0, le=1, description="share of open grounds instead of rooms")
        textures: int = Field(96, ge=4, le=512, description="size of the texture bank")
        edit: Literal["none", "recolor", "add", "remove", "global", "any"] = Field(
            "none", description="the edited truth that comes along"
        )
        edit_seed: int = Field(0, ge=0, description="other numbers edit the same scenes in other ways")
        keep: bool = Field(False, description="keep samples in memory once made (about 0.3 MB each at 64 pixels)")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._kept: dict[int, SceneSample] = {}

    def __len__(self) -> int:
        return self.settings.scenes

    def __getitem__(self, index: int) -> SceneSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        if index in self._kept:
            return _unpacked(self._kept[index])
        packed = _packed(self._made(index))
        if self.settings.keep:
            self._kept[index] = packed
        return _unpacked(packed)

    def _made(self, index: int) -> SceneSample:
        chosen = self.settings
        rng = np.random.default_rng((chosen.seed, index))
        context, targets = random_cameras(rng, chosen.context, chosen.targets, chosen.angles)
        poses = np.concatenate((context, targets))
        size = (chosen.image_size, chosen.image_size)
        k = intrinsics_from_fov(float(np.deg2rad(rng.uniform(42, 68))), size)
        scene = random_scene(
            rng,
            objects=int(rng.integers(chosen.objects[0], chosen.objects[1] + 1)),
            texture_count=chosen.textures,
            avoid=poses[:, :3, 3],
            outdoor=bool(rng.random() < chosen.outdoor),
        )
        if chosen.edit_seed:
            rng = np.random.default_rng((chosen.seed, index, chosen.edit_seed))
        edit = str(rng.choice(EDITS)) if chosen.edit == "any" else chosen.edit
        return self._sample(scene, poses, k, rng, edit, name=f"procedural-{chosen.seed}-{index}")

    def _sample(
        self, scene: Scene, poses: np.ndarray, k: torch.Tensor, rng: np.random.Generator, edit: str, name: str
    ) -> SceneSample:
        """Cast the pictures and, if asked for, the edited ones; for `add` the unedited scene lacks its last object."""
        views = self.settings.context
        before = scene.first(scene.count - 1) if edit == "add" and scene.count > 2 else scene
        cast_all = [self._cast(before, pose, k) for pose in poses]
        images = torch.from_numpy(np.stack([p.image for p in cast_all])).permute(0, 3, 1, 2).contiguous()
        masks = torch.from_numpy(np.stack([p.coverage(before.count) for p in cast_all], 1))
        edited = self._edited(scene, before, poses, k, rng, edit, images, masks)
        relative = torch.from_numpy(np.linalg.inv(poses[0]) @ poses).float()
        relative[0] = torch.eye(4)
        return SceneSample(
            context=images[:views],
            target=images[views:],
            context_cameras=self._cameras(relative[:views], k),
            target_cameras=self._cameras(relative[views:], k),
            context_depths=torch.from_numpy(np.stack([p.depth for p in cast_all[:views]])),
            context_masks=masks[:, :views],
            target_masks=masks[:, views:],
            edited_context=None if edited is None else edited[:views],
            edited_target=None if edited is None else edited[views:],
            name=name,
        )

    def _edited(self, scene, before, poses, k, rng, edit, images, masks) -> torch.Tensor | None:
        if edit == "none":
            return None
        if edit in ("recolor", "global"):
            area = masks[1:, 0].mean((1, 2)) if before.count > 1 else masks[:, 0].mean((1, 2))
            region = torch.ones_like(masks[0]) if edit == "global" else masks[_pick(rng, area) + (before.count > 1)]
            return recolored(images, region[None], [visible_parameters(rng, images, region)])
        after = scene
        if edit == "remove" and scene.count > 1:
            after = scene.without(1 + _pick(rng, masks[1:, 0].mean((1, 2))))
        cast_all = [self._cast(after, pose, k) for pose in poses]
        return torch.from_numpy(np.stack([p.image for p in cast_all])).permute(0, 3, 1, 2).contiguous()

    def _cast(self, scene: Scene, pose: np.ndarray, k: torch.Tensor) -> CastPicture:
        size = (self.settings.image_size, self.settings.image_size)
        bank = texture_bank(self.settings.textures)
        return cast(scene, bank, pose, k.double().numpy(), size)

    def _cameras(self, c2w: torch.Tensor, k: torch.Tensor) -> Cameras:
        size = (self.settings.image_size, self.settings.image_size)
        return Cameras(c2w[None], k.expand(1, len(c2w), 3, 3), size)


def _packed(sample: SceneSample) -> SceneSample:
    """Pictures and masks in 8 bits, as photos are; objects that no view shows are left out."""
    seen = (sample.context_masks.amax((1, 2, 3)) > 0) | (sample.target_masks.flatten(1).sum(1) > 0)
    kept = replace(sample, context_masks=sample.context_masks[seen], target_masks=sample.target_masks[seen])
    eight = {name: getattr(kept, name) for name in _EIGHT_BITS if getattr(kept, name) is not None}
    return replace(kept, **{name: (value * 255).round().to(torch.uint8) for name, value in eight.items()})


def _unpacked(sample: SceneSample) -> SceneSample:
    eight = {name: getattr(sample, name) for name in _EIGHT_BITS if getattr(sample, name) is not None}
    return replace(sample, **{name: value.float() / 255 for name, value in eight.items()})


def _pick(rng: np.random.Generator, area: torch.Tensor) -> int:
    """An object that view 0 shows well (at least 2 % of the picture), else the largest."""
    visible = np.flatnonzero(area.numpy() > 0.02)
    return int(rng.choice(visible)) if len(visible) else int(area.argmax())
