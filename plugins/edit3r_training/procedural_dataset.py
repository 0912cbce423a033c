"""Dataset `procedural`: endless random scenes, each a function of (seed, index)."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from edit3r_recolor.api import recolored, visible_parameters
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.contract.interfaces import Dataset, SceneSample
from edit3r.contract.types import Cameras
from edit3r.geometry.cameras import intrinsics_from_fov
from edit3r_training.procedural_scenes import (
    Scene,
    random_cameras,
    random_scene,
    texture_bank,
)
from edit3r_training.raycaster import CastImage, cast

EIGHT_BITS = (
    "context",
    "target",
    "context_masks",
    "target_masks",
    "edited_context",
    "edited_target",
)
EDITS = ("recolor", "add", "remove", "global")


class ProceduralDataset(Dataset):
    """Textured rooms and open grounds with many objects; exact poses, depth, masks and edited
    truth.
    """

    class Settings(config.Settings):
        scenes: int = Field(100_000, ge=1, description="number of samples")
        seed: int = Field(0, ge=0, description="two seeds share no scene")
        image_size: int = Field(
            64, ge=8, le=1024, description="height and width of the images [pixels]"
        )
        context: int = Field(2, ge=1, le=16, description="input views")
        targets: int = Field(2, ge=0, le=16, description="novel views")
        angles: tuple[float, float] = Field(
            (4.0, 30.0),
            description="least and most angle between input views [degrees]",
        )
        objects: tuple[int, int] = Field(
            (5, 16), description="least and most objects besides the room"
        )
        outdoor: float = Field(
            0.35, ge=0, le=1, description="share of open grounds instead of rooms"
        )
        textures: int = Field(96, ge=4, le=512, description="size of the texture bank")
        edit: Literal["none", "recolor", "add", "remove", "global", "any"] = Field(
            "none", description="the edited truth that comes along"
        )
        edit_seed: int = Field(
            0, ge=0, description="other numbers edit the same scenes in other ways"
        )
        keep: bool = Field(
            False,
            description="keep samples in memory once made (about 0.3 MB each at 64 pixels)",
        )

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
        """Draw scene, cameras and edit, and cast the images; for `add` the unedited scene lacks its
        last object.
        """
        chosen = self.settings
        rng = np.random.default_rng((chosen.seed, index))
        poses = random_cameras(rng, chosen.context, chosen.targets, chosen.angles)
        k = intrinsics_from_fov(
            float(np.deg2rad(rng.uniform(42, 68))),
            (chosen.image_size, chosen.image_size),
        )
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
        unedited = (
            scene.first(scene.count - 1) if edit == "add" and scene.count > 2 else scene
        )
        shown = self._cast(unedited, poses, k)
        edited = None if edit == "none" else self._edited(edit, scene, shown, rng)
        return self._sample(shown, edited, name=f"procedural-{chosen.seed}-{index}")

    def _cast(
        self,
        scene: Scene,
        poses: Float[np.ndarray, "view 4 4"],
        k: Float[Tensor, "3 3"],
    ) -> "_CastViews":
        """All views of a scene; `poses` camera-to-world, `k` normalised intrinsics."""
        size = (self.settings.image_size, self.settings.image_size)
        bank = texture_bank(self.settings.textures)
        return _CastViews(
            poses,
            k,
            scene.count,
            [cast(scene, bank, pose, k.double().numpy(), size) for pose in poses],
        )

    def _edited(
        self, edit: str, scene: Scene, shown: "_CastViews", rng: np.random.Generator
    ) -> Float[Tensor, "view 3 height width"]:
        """The images of the edited scene."""
        if edit in ("recolor", "global"):
            objects = shown.masks[1:] if shown.objects > 1 else shown.masks
            region = (
                torch.ones_like(objects[0])
                if edit == "global"
                else objects[_pick(rng, objects)]
            )
            return recolored(
                shown.images,
                region[None],
                [visible_parameters(rng, shown.images, region)],
            )
        after = scene
        if edit == "remove" and scene.count > 1:
            after = scene.without(1 + _pick(rng, shown.masks[1:]))
        return self._cast(after, shown.poses, shown.intrinsics).images

    def _sample(
        self,
        shown: "_CastViews",
        edited: Float[Tensor, "view 3 height width"] | None,
        name: str,
    ) -> SceneSample:
        """The sample with poses relative to the first view."""
        views, images, masks = self.settings.context, shown.images, shown.masks
        relative = torch.from_numpy(np.linalg.inv(shown.poses[0]) @ shown.poses).float()
        relative[0] = torch.eye(4)
        k = shown.intrinsics.expand(1, len(relative), 3, 3)
        size = (self.settings.image_size, self.settings.image_size)
        return SceneSample(
            context=images[:views],
            target=images[views:],
            context_cameras=Cameras(relative[None, :views], k[:, :views], size),
            target_cameras=Cameras(relative[None, views:], k[:, views:], size),
            context_depths=torch.from_numpy(
                np.stack([view.depth for view in shown.views[:views]])
            ),
            context_masks=masks[:, :views],
            target_masks=masks[:, views:],
            edited_context=None if edited is None else edited[:views],
            edited_target=None if edited is None else edited[views:],
            name=name,
        )


@dataclass(frozen=True)
class _CastViews:
    """All views of one scene, the context views first."""

    poses: Float[np.ndarray, "view 4 4"]  # camera-to-world
    intrinsics: Float[Tensor, "3 3"]  # normalised
    objects: int
    views: list[CastImage]

    @cached_property
    def images(self) -> Float[Tensor, "view 3 height width"]:
        return (
            torch.from_numpy(np.stack([view.image for view in self.views]))
            .permute(0, 3, 1, 2)
            .contiguous()
        )

    @cached_property
    def masks(self) -> Float[Tensor, "object view height width"]:
        return torch.from_numpy(
            np.stack([view.coverage(self.objects) for view in self.views], 1)
        )


def _packed(sample: SceneSample) -> SceneSample:
    """Images and masks in 8 bits, as photos are; objects that no view shows are left out."""
    seen = (sample.context_masks.amax((1, 2, 3)) > 0) | (
        sample.target_masks.flatten(1).sum(1) > 0
    )
    kept = replace(
        sample,
        context_masks=sample.context_masks[seen],
        target_masks=sample.target_masks[seen],
    )
    eight = {
        name: getattr(kept, name)
        for name in EIGHT_BITS
        if getattr(kept, name) is not None
    }
    return replace(
        kept,
        **{
            name: (value * 255).round().to(torch.uint8) for name, value in eight.items()
        },
    )


def _unpacked(sample: SceneSample) -> SceneSample:
    eight = {
        name: getattr(sample, name)
        for name in EIGHT_BITS
        if getattr(sample, name) is not None
    }
    return replace(
        sample, **{name: value.float() / 255 for name, value in eight.items()}
    )


def _pick(
    rng: np.random.Generator, masks: Float[Tensor, "object view height width"]
) -> int:
    """An object that view 0 shows well (at least 2 % of the image), else the largest there."""
    area = masks[:, 0].mean((1, 2))
    visible = np.flatnonzero(area.numpy() > 0.02)
    return int(rng.choice(visible)) if len(visible) else int(area.argmax())
