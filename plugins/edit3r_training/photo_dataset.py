"""Training samples from photos with known cameras: which views are drawn, and what a sample of them
looks like.
"""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.contract.interfaces import Dataset, SceneSample
from edit3r.contract.types import Cameras
from edit3r.errors import InputError
from edit3r.geometry.cameras import relative_to_first

MIRROR = torch.diag(torch.tensor([-1.0, 1, 1, 1]))


class PhotoSettings(config.Settings):
    """What all datasets of photos can be set to; each gives its own defaults."""

    root: str = Field(description="folder with the scenes")
    samples: int = Field(1, ge=1, description="draws per scene")
    seed: int = Field(0, ge=0, description="of view choice and mirroring")
    image_size: int = Field(
        256, ge=16, le=1024, description="side of the centred square [pixels]"
    )
    context: int = Field(2, ge=2, le=16, description="input views")
    targets: int = Field(4, ge=0, le=16, description="novel views")
    gap: tuple[int, int] = Field(
        (45, 90), description="from first to last context view [frames]"
    )
    gap_start: tuple[int, int] | None = Field(
        None, description="gap when training begins; default: as `gap`"
    )
    gap_growth: float = Field(
        0.5,
        gt=0,
        le=1,
        description="share of the training in which `gap_start` grows evenly to `gap`",
    )
    mirror: float = Field(
        0.5, ge=0, le=1, description="share of samples mirrored left to right"
    )


class PhotoDataset(Dataset):
    """One sample is one draw of views from one scene; a scene that cannot be used is skipped and
    named once.
    """

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
        """Draw views of one scene, first to last `gap` frames apart; raises InputError when it
        cannot be used.
        """

    @abstractmethod
    def _label(self, scene: Any) -> str:
        """What a warning calls a scene."""

    def __len__(self) -> int:
        return len(self.scenes) * self.settings.samples

    def __getitem__(self, index: int) -> SceneSample:
        return self.at_progress(index, 1.0)

    def at_progress(self, index: int, progress: float) -> SceneSample:
        """Return the sample with the gap of that time of a training: a curriculum from near views
        to far ones.
        """
        gap = growing_gap(
            self.settings.gap_start,
            self.settings.gap,
            progress / self.settings.gap_growth,
        )
        if not 0 <= index < len(self):
            raise IndexError(index)
        for attempt in range(len(self.scenes)):
            scene = self.scenes[(index + attempt) % len(self.scenes)]
            rng = np.random.default_rng((self.settings.seed, index))
            try:
                drawn = self._draw(scene, rng, gap)
            except InputError as error:
                self._skip(self._label(scene), str(error))
            else:
                return drawn.sample(
                    self.settings.context,
                    f"{drawn.scene}-{index}",
                    self.settings.mirror,
                    rng,
                )
        raise InputError(
            f"{self.settings.root}: none of its {len(self.scenes)} scenes can be used."
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
    images: Float[Tensor, "view 3 height width"]
    c2w: Float[Tensor, "view 4 4"]  # in any frame and unit
    intrinsics: Float[Tensor, "view 3 3"]  # normalised
    masks: Float[Tensor, "object view height width"] | None = None

    def sample(
        self, context: int, name: str, mirror: float, rng: np.random.Generator
    ) -> SceneSample:
        """Make a sample of the views, the first `context` of which are context and the rest
        targets.

        Poses are relative to the first view. Lengths are divided by the distance between the first
        and the last context camera. With probability `mirror`, images, masks and poses are mirrored
        left to right.
        """
        images, intrinsics, masks = self.images, self.intrinsics, self.masks
        poses = relative_to_first(self.c2w[None].double())[0]
        baseline = poses[context - 1, :3, 3].norm()
        poses[:, :3, 3] /= baseline.clamp(min=1e-9)
        poses = poses.float()
        if rng.random() < mirror:
            images = images.flip(-1)
            masks = None if masks is None else masks.flip(-1)
            poses = MIRROR @ poses @ MIRROR
            intrinsics = intrinsics.clone()
            intrinsics[:, 0, 2] = 1 - intrinsics[:, 0, 2]
        size = (images.shape[-2], images.shape[-1])
        return SceneSample(
            context=images[:context],
            target=images[context:],
            context_cameras=Cameras(
                poses[None, :context], intrinsics[None, :context], size
            ),
            target_cameras=Cameras(
                poses[None, context:], intrinsics[None, context:], size
            ),
            context_masks=None if masks is None else masks[:, :context],
            target_masks=None if masks is None else masks[:, context:],
            name=name,
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
    return [
        *map(int, chosen),
        *map(int, rng.integers(first, first + width + 1, targets)),
    ]


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
    """Draw from the photos nearest to the middle of the context cameras, twice as many as
    needed.
    """
    middle = c2w[context, :3, 3].mean(0)
    order = np.argsort(np.linalg.norm(c2w[:, :3, 3] - middle, axis=1), kind="stable")
    near = [int(i) for i in order if i not in context][: 2 * targets] or context
    return [int(i) for i in rng.choice(near, targets, replace=len(near) < targets)]
