"""One training step's data: samples, their edits and their (simulated) matched geometry, stacked."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import unproject
from edit3r.interfaces import MatchedGeometry, SceneSample
from edit3r.types import Cameras, Views
from edit3r_training.asymmetric_inputs import EditedSample, RegimeShares, edit_sample
from edit3r_training.simulated_matching import simulate_match


@dataclass(frozen=True)
class TrainingBatch:
    """B scenes of V context and T target views; all lengths in the unit of `geometry` where there is one."""

    source: Views  # unedited context
    edited: Views  # what the reconstructor is given
    truth: Float[Tensor, "batch view 3 height width"]  # what each context view should show
    target: Float[Tensor, "batch target 3 height width"]  # what each target view should show
    context_cameras: Cameras
    target_cameras: Cameras
    depths: Float[Tensor, "batch view height width"] | None  # true camera z
    geometry: MatchedGeometry | None  # as a matcher would give it; None when the data has no depths
    regimes: tuple[str, ...]

    def to(self, device: torch.device) -> "TrainingBatch":
        """Everything on another device."""
        return replace(self, **{field.name: _moved(getattr(self, field.name), device) for field in fields(self)})

    def true_centres(self) -> Float[Tensor, "batch gaussian 3"] | None:
        """Surface points of all context pixels, view-major, row-major."""
        if self.depths is None:
            return None
        points = unproject(self.depths, self.source.intrinsics, self.context_cameras.c2w)
        return points.reshape(len(points), -1, 3)


def _moved(value: Any, device: torch.device) -> Any:
    """The value of a field on another device."""
    if isinstance(value, Tensor | Views | Cameras):
        return value.to(device)
    if isinstance(value, MatchedGeometry):
        return replace(value, **{field.name: _moved(getattr(value, field.name), device) for field in fields(value)})
    return value


def make_batch(
    samples: Sequence[SceneSample], shares: RegimeShares, generators: Sequence[np.random.Generator]
) -> TrainingBatch:
    """Edit every sample and corrupt its geometry, each with its own random numbers."""
    items = [_Item.made(sample, shares, rng) for sample, rng in zip(samples, generators)]
    size = items[0].sample.context_cameras.image_size
    intrinsics = torch.cat([item.sample.context_cameras.intrinsics for item in items])
    has_depths = items[0].sample.context_depths is not None
    return TrainingBatch(
        source=Views(torch.stack([item.sample.context for item in items]), intrinsics),
        edited=Views(torch.stack([item.edit.edited for item in items]), intrinsics),
        truth=torch.stack([item.edit.truth for item in items]),
        target=torch.stack([item.edit.target for item in items]),
        context_cameras=_joined([item.sample.context_cameras for item in items], size),
        target_cameras=_joined([item.sample.target_cameras for item in items], size),
        depths=torch.stack([item.sample.context_depths for item in items]) if has_depths else None,
        geometry=_joined_geometry([item.geometry for item in items]) if has_depths else None,
        regimes=tuple(item.edit.regime for item in items),
    )


@dataclass(frozen=True)
class _Item:
    sample: SceneSample
    edit: EditedSample
    geometry: MatchedGeometry | None

    @staticmethod
    def made(sample: SceneSample, shares: RegimeShares, rng: np.random.Generator) -> "_Item":
        edit = edit_sample(sample, shares, rng)
        if sample.context_depths is None:
            return _Item(sample, edit, None)
        match = simulate_match(sample, rng)
        return _Item(_in_unit(sample, match.unit), edit, match.geometry)


def _in_unit(sample: SceneSample, unit: float) -> SceneSample:
    """All lengths times `unit`, as the matcher cannot know the scene's own."""
    return replace(
        sample,
        context_depths=sample.context_depths * unit,
        context_cameras=_scaled(sample.context_cameras, unit),
        target_cameras=_scaled(sample.target_cameras, unit),
    )


def _scaled(cameras: Cameras, unit: float) -> Cameras:
    c2w = cameras.c2w.clone()
    c2w[..., :3, 3] *= unit
    return replace(cameras, c2w=c2w)


def _joined(cameras: Sequence[Cameras], size: tuple[int, int]) -> Cameras:
    return Cameras(torch.cat([c.c2w for c in cameras]), torch.cat([c.intrinsics for c in cameras]), size)


def _joined_geometry(parts: Sequence[MatchedGeometry]) -> MatchedGeometry:
    names = ("c2w", "depths", "confidence", "registered")
    return MatchedGeometry(*(torch.cat([getattr(part, name) for part in parts]) for name in names))
