"""Training samples from photos with known cameras: which views are drawn, and what a sample of them
looks like.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract import reporting, settings as config
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Dataset, SceneSample
from edit3r.contract.settings import Count, Index, Share
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import relative_to_first
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.photos.posed_folder import PosedPhoto
from edit3r_training.spans import CountSpan, Span

Images = Float[Tensor, "view 3 height width"]

MIRROR = torch.diag(torch.tensor([-1.0, 1, 1, 1]))


class PhotoSettings(config.Settings):
    """What all datasets of photos can be set to; each gives its own defaults."""

    root: str
    """folder with the scenes"""
    samples: Count = 1
    """draws per scene"""
    seed: Index = 0
    """of view choice and mirroring"""
    image_size: int = Field(256, ge=16, le=1024)
    """side of the centred square [pixels]"""
    context: int = Field(2, ge=2, le=16)
    """input views"""
    targets: int = Field(4, ge=0, le=16)
    """novel views"""
    gap: CountSpan = (45, 90)
    """from first to last context view [frames]"""
    gap_start: CountSpan | None = None
    """gap when training begins; default: as `gap`"""
    gap_growth: float = Field(0.5, gt=0, le=1)
    """share of the training in which `gap_start` grows evenly to `gap`"""
    baseline: Span = (1e-3, 1e10)
    """from first to last context camera [units of the data]; others are skipped"""
    max_fov: float = Field(100.0, gt=0, lt=180)
    """wider images are skipped [degrees]"""
    mirror: Share = 0.5
    """share of samples mirrored left to right"""


class PhotoDataset(Dataset):
    """A sample is one draw of views of a scene; one that cannot be used is named once."""

    name: ClassVar[str]  # in warnings
    settings: PhotoSettings

    def __init__(self, settings: PhotoSettings) -> None:
        self.settings = settings
        self._skipped: set[str] = set()

    @cached_property
    @abstractmethod
    def scenes(self) -> list[Any]:
        """All scenes under the root; raises InputError when there are none."""

    @abstractmethod
    def _draw(
        self, scene: Any, rng: np.random.Generator, gap: tuple[int, int]
    ) -> "DrawnPhotos":
        """Views of a scene, first to last `gap` frames apart. Raises InputError without any."""

    @abstractmethod
    def _label(self, scene: Any) -> str:
        """What a warning calls a scene."""

    def __len__(self) -> int:
        return len(self.scenes) * self.settings.samples

    def __getitem__(self, index: int) -> SceneSample:
        return self.at_progress(index, 1.0)

    def at_progress(self, index: int, progress: float) -> SceneSample:
        """The sample with the gap of that time of a training, which goes from near to far views."""
        chosen = self.settings
        way = progress / chosen.gap_growth
        gap = growing_gap(chosen.gap_start, chosen.gap, way)
        if not 0 <= index < len(self):
            raise IndexError(index)
        for attempt in range(len(self.scenes)):
            scene = self.scenes[(index + attempt) % len(self.scenes)]
            rng = np.random.default_rng((chosen.seed, index))
            try:
                drawn = self._draw(scene, rng, gap)
                drawn.check(chosen)
            except InputError as error:
                self._skip(self._label(scene), str(error))
                continue
            name = f"{drawn.scene}-{index}"
            mirrored = rng.random() < chosen.mirror
            return drawn.sample(chosen.context, name, mirrored)
        raise InputError(
            f"{chosen.root}: none of its {len(self.scenes)} scenes can be used."
        )

    def _skip(self, label: str, reason: str) -> None:
        """Warn of a scene that cannot be used, the first time."""
        if label not in self._skipped:
            self._skipped.add(label)
            reporting.warn(
                f"dataset {self.name}: {label} is skipped ({len(self._skipped)} so far): {reason}"
            )


@dataclass(frozen=True)
class DrawnPhotos:
    """Photos of one scene, the context views first, as the dataset's files have them."""

    scene: str
    images: Images
    c2w: Float[Tensor, "view 4 4"]  # in any frame and unit
    intrinsics: Float[Tensor, "view 3 3"]  # normalised
    masks: Float[Tensor, "object view height width"] | None = None
    edited: Images | None = None

    @staticmethod
    def of(scene: str, photos: Sequence[PosedPhoto], **more: Any) -> "DrawnPhotos":
        """The photos, with `more` of what is known of them."""
        images, lenses, poses = (
            torch.from_numpy(np.stack([getattr(photo, name) for photo in photos]))
            for name in ("image", "intrinsics", "c2w")
        )
        images = images.permute(0, 3, 1, 2).contiguous()
        return DrawnPhotos(scene, images, poses, lenses.float(), **more)

    def check(self, settings: PhotoSettings) -> None:
        """Raise InputError for cameras that stand too near or too far apart, and for wide lenses.

        A clip of a camera that stands still would be blown up without end.
        """
        least, most = settings.baseline
        baseline = (self.c2w[settings.context - 1] - self.c2w[0])[:3, 3].norm().item()
        if not least <= baseline <= most:
            raise InputError(
                f"{self.scene}: its context cameras are {baseline:.3g} apart; expected {least:g} "
                f"to {most:g} (setting baseline)."
            )
        focal = self.intrinsics.diagonal(dim1=-2, dim2=-1)[:, :2]
        fov = 2 * torch.atan(0.5 / focal).max().rad2deg().item()
        if fov > settings.max_fov:
            raise InputError(
                f"{self.scene}: a field of view of {fov:.0f} degrees; expected at most "
                f"{settings.max_fov:g} (setting max_fov)."
            )

    def sample(self, context: int, name: str, mirrored: bool) -> SceneSample:
        """Make a sample of the views, the first `context` of which are context and the rest
        targets.

        Poses are relative to the first view. Lengths are divided by the distance between the first
        and the last context camera. `mirrored`: images, masks and poses are flipped left to right.
        """
        poses = relative_to_first(self.c2w[None].double())[0]
        poses[:, :3, 3] /= poses[context - 1, :3, 3].norm()
        poses, intrinsics = poses.float(), self.intrinsics
        images, masks, edited = self.images, self.masks, self.edited
        if mirrored:
            poses = MIRROR @ poses @ MIRROR
            intrinsics = intrinsics.clone()
            intrinsics[:, 0, 2] = 1 - intrinsics[:, 0, 2]
            images = images.flip(-1)
            masks = None if masks is None else masks.flip(-1)
            edited = None if edited is None else edited.flip(-1)
        cameras = Cameras(poses[None], intrinsics[None], size_of(images))
        return divided(context, images, cameras, masks, edited, name=name)


def divided(
    context: int,
    images: Images,
    cameras: Cameras,
    masks: Float[Tensor, "object view height width"] | None,
    edited: Images | None,
    **more: Any,
) -> SceneSample:
    """The sample of views of which the first `context` are context and the rest targets."""
    return SceneSample(
        context=images[:context],
        target=images[context:],
        context_cameras=cameras.select(range(context)),
        target_cameras=cameras.select(range(context, cameras.count)),
        context_masks=None if masks is None else masks[:, :context],
        target_masks=None if masks is None else masks[:, context:],
        edited_context=None if edited is None else edited[:context],
        edited_target=None if edited is None else edited[context:],
        **more,
    )


def growing_gap(
    start: tuple[int, int] | None, end: tuple[int, int], way: float
) -> tuple[int, int]:
    """Least and most frames, `way` of the way from `start` to `end`; above 1 it is `end`."""
    if start is None or way >= 1:
        return end
    least, most = (round(a + (b - a) * way) for a, b in zip(start, end))
    return least, most


def choose_by_gap(
    rng: np.random.Generator,
    count: int,
    context: int,
    targets: int,
    gap: tuple[int, int],
) -> list[int] | None:
    """Indices of context views spread evenly over `gap` frames, then of targets uniform in between
    (ends included).

    None when the sequence of `count` frames is too short.
    """
    most = min(gap[1], count - 1)
    least = max(min(gap[0], most), context - 1)
    if count < max(context, 2) or least > most:
        return None
    width = int(rng.integers(least, most + 1))
    first = int(rng.integers(count - width))
    chosen = np.linspace(first, first + width, context).round().astype(int)
    between = rng.integers(first, first + width + 1, targets)
    return [*chosen.tolist(), *between.tolist()]


def choose_by_angle(
    rng: np.random.Generator,
    c2w: Float[np.ndarray, "photo 4 4"],
    context: int,
    targets: int,
    angles: tuple[float, float],
) -> list[int] | None:
    """Indices of context views whose neighbours look `angles` [degrees] apart, then of targets near
    their middle.

    For unordered photos; None when no photos are that far apart.
    """
    forward = c2w[:, :3, 2] / np.linalg.norm(c2w[:, :3, 2], axis=1, keepdims=True)
    apart = np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)))
    for first in rng.permutation(len(c2w)):
        chosen = [int(first)]
        while len(chosen) < context:
            fit = (apart[chosen[-1]] >= angles[0]) & (apart[chosen[-1]] <= angles[1])
            fit[chosen] = False
            if not fit.any():
                break
            chosen.append(int(rng.choice(np.flatnonzero(fit))))
        if len(chosen) == context:
            return chosen + _near_middle(rng, c2w, chosen, targets)
    return None


def _near_middle(
    rng: np.random.Generator,
    c2w: Float[np.ndarray, "photo 4 4"],
    context: list[int],
    targets: int,
) -> list[int]:
    """Of the photos nearest to the middle of the context cameras, twice as many as needed."""
    middle = c2w[context, :3, 3].mean(0)
    order = np.linalg.norm(c2w[:, :3, 3] - middle, axis=1).argsort(kind="stable")
    near = order[~np.isin(order, context)][: 2 * targets].tolist() or context
    return rng.choice(near, targets, replace=len(near) < targets).tolist()
