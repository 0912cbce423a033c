"""Dataset `procedural`: endless random scenes, each a function of (seed, index)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import torch
from edit3r_recolor.api import recolored, visible_parameters
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.interfaces import Dataset, SceneSample
from edit3r.contract.settings import Count, Index, Share
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.geometry.maps import size_of
from edit3r_training.photo_dataset import divided
from edit3r_training.procedural_scenes import (
    ProceduralScene,
    random_cameras,
    random_scene,
    texture_bank,
)
from edit3r_training.raycaster import CastImage, cast
from edit3r_training.spans import CountSpan, Span

EIGHT_BITS = (
    *("context", "context_masks", "edited_context"),
    *("target", "target_masks", "edited_target"),
)
"""Images and masks of a sample: kept in 8 bits, as photos are."""
EDITS = ("recolor", "add", "remove", "global")
DRAWN = {"any": EDITS, "shape": ("add", "remove")}
"""Settings that stand for an edit drawn anew for every scene."""

Images = Float[Tensor, "view 3 height width"]


class ProceduralDataset(Dataset):
    """Textured rooms and open grounds with objects; exact poses, depth, masks, edited truth."""

    class Settings(edit3r.Settings):
        scenes: Count = 100_000
        """number of samples"""
        seed: Index = 0
        """two seeds share no scene"""
        image_size: int = Field(64, ge=8, le=1024)
        """height and width of the images [pixels]"""
        context: int = Field(2, ge=2, le=16)
        """input views"""
        targets: int = Field(2, ge=0, le=16)
        """novel views"""
        angles: Span = (4.0, 30.0)
        """least and most angle between input views [degrees]"""
        objects: CountSpan = (5, 16)
        """least and most objects besides the room"""
        outdoor: Share = 0.35
        """share of open grounds instead of rooms"""
        textures: int = Field(96, ge=4, le=512)
        """size of the texture bank"""
        edit: Literal["none", "recolor", "add", "remove", "global", "any", "shape"] = (
            "none"
        )
        """the edited truth that comes along; any: one of these, shape: add or remove, drawn for
        every scene
        """
        edit_seed: Index = 0
        """other numbers edit the same scenes in other ways"""
        keep: bool = False
        """keep samples in memory once made (about 0.3 MB each at 64 pixels)"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._kept: dict[int, SceneSample] = {}

    def __len__(self) -> int:
        return self.settings.scenes

    def __getitem__(self, index: int) -> SceneSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        packed = self._kept.get(index) or _packed(self._made(index))
        if self.settings.keep:
            self._kept[index] = packed
        return _with_images(packed, lambda x: x.float() / 255)

    def _made(self, index: int) -> SceneSample:
        """Draw scene, cameras, edit, and cast them; for `add` the scene lacks its last object."""
        chosen = self.settings
        rng = np.random.default_rng((chosen.seed, index))
        poses = random_cameras(rng, chosen.context, chosen.targets, chosen.angles)
        size = (chosen.image_size, chosen.image_size)
        k = intrinsics_from_fov(float(np.deg2rad(rng.uniform(42, 68))), size)
        least, most = chosen.objects
        scene = random_scene(
            rng,
            objects=int(rng.integers(least, most + 1)),
            texture_count=chosen.textures,
            avoid=poses[:, :3, 3],
            outdoor=bool(rng.random() < chosen.outdoor),
        )
        if chosen.edit_seed:
            rng = np.random.default_rng((chosen.seed, index, chosen.edit_seed))
        drawn = DRAWN.get(chosen.edit)
        edit = str(rng.choice(drawn)) if drawn else chosen.edit
        adds = edit == "add" and scene.count > 2
        unedited = scene.first(scene.count - 1) if adds else scene
        shown = self._cast(unedited, poses, k)
        edited = None if edit == "none" else self._edited(edit, scene, shown, rng)
        return self._sample(shown, edited, name=f"procedural-{chosen.seed}-{index}")

    def _cast(
        self,
        scene: ProceduralScene,
        poses: Float[np.ndarray, "view 4 4"],
        k: Float[Tensor, "3 3"],
    ) -> "_CastViews":
        """All views of a scene; `poses` camera-to-world, `k` normalised intrinsics."""
        size = (self.settings.image_size, self.settings.image_size)
        bank, lens = texture_bank(self.settings.textures), k.double().numpy()
        views = [cast(scene, bank, pose, lens, size) for pose in poses]
        return _CastViews(poses, k, scene.count, views)

    def _edited(
        self,
        edit: str,
        scene: ProceduralScene,
        shown: "_CastViews",
        rng: np.random.Generator,
    ) -> Images:
        """The images of the edited scene."""
        if edit in ("recolor", "global"):
            objects = shown.masks[1:] if shown.objects > 1 else shown.masks
            region = torch.ones_like(objects[0])
            if edit == "recolor":
                region = objects[_pick(rng, objects)]
            parameters = visible_parameters(rng, shown.images, region)
            return recolored(shown.images, region[None], [parameters])
        after = scene
        if edit == "remove" and scene.count > 1:
            after = scene.without(1 + _pick(rng, shown.masks[1:]))
        return self._cast(after, shown.poses, shown.intrinsics).images

    def _sample(
        self, shown: "_CastViews", edited: Images | None, name: str
    ) -> SceneSample:
        """The sample with poses relative to the first view."""
        relative = torch.from_numpy(np.linalg.inv(shown.poses[0]) @ shown.poses).float()
        relative[0] = torch.eye(4)
        k = shown.intrinsics.expand(1, len(relative), 3, 3)
        cameras = Cameras(relative[None], k, size_of(shown.images))
        context = self.settings.context
        depths = np.stack([view.depth for view in shown.views[:context]])
        known = {"context_depths": torch.from_numpy(depths), "name": name}
        return divided(context, shown.images, cameras, shown.masks, edited, **known)


@dataclass(frozen=True)
class _CastViews:
    """All views of one scene, the context views first."""

    poses: Float[np.ndarray, "view 4 4"]  # camera-to-world
    intrinsics: Float[Tensor, "3 3"]  # normalised
    objects: int
    views: list[CastImage]

    @cached_property
    def images(self) -> Images:
        images = torch.from_numpy(np.stack([view.image for view in self.views]))
        return images.permute(0, 3, 1, 2).contiguous()

    @cached_property
    def masks(self) -> Float[Tensor, "object view height width"]:
        masks = [view.coverage(self.objects) for view in self.views]
        return torch.from_numpy(np.stack(masks, 1))


def _packed(sample: SceneSample) -> SceneSample:
    """Images and masks in 8 bits; objects that no view shows are left out."""
    context, target = sample.context_masks, sample.target_masks
    assert context is not None and target is not None  # every scene here has them
    seen = context.amax((1, 2, 3)) > 0
    seen |= target.flatten(1).sum(1) > 0
    kept = replace(sample, context_masks=context[seen], target_masks=target[seen])
    return _with_images(kept, lambda x: (x * 255).round().to(torch.uint8))


def _with_images(
    sample: SceneSample, function: Callable[[Tensor], Tensor]
) -> SceneSample:
    """The sample with `function` of all its images and masks."""
    images = {name: getattr(sample, name) for name in EIGHT_BITS}
    known = {name: image for name, image in images.items() if image is not None}
    changed: dict[str, Any] = {name: function(image) for name, image in known.items()}
    return replace(sample, **changed)


def _pick(
    rng: np.random.Generator, masks: Float[Tensor, "object view height width"]
) -> int:
    """An object that view 0 shows well (at least 2 % of the image), else the largest there."""
    area = masks[:, 0].mean((1, 2))
    visible = np.flatnonzero(area.numpy() > 0.02)
    return int(rng.choice(visible)) if len(visible) else int(area.argmax())
