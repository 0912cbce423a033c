"""One training step's data: samples, their edits and their (simulated) matched geometry,
stacked.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry, SceneSample
from edit3r.contract.types import Cameras, Tensors, Views
from edit3r.kit.geometry.cameras import scale_poses, unproject
from edit3r_training.asymmetric_inputs import EditedSample, RegimeShares, edit_sample
from edit3r_training.simulated_matching import SimulatedMatch, simulate_match

Images = Float[Tensor, "batch view 3 height width"]
OTHER_SURFACE = 0.02
"""Change of a generated edit above which another surface may be seen [sRGB, any channel].
No figure kept.
"""


@dataclass(frozen=True, repr=False)
class TrainingBatch(Tensors):
    """B scenes of V context and T target views, in the unit of `geometry` where there is one."""

    source: Views  # unedited context
    edited: Views  # what the reconstructor is given
    truth: Images  # what each context view should show
    target: Images  # what each target view should show
    context_cameras: Cameras
    target_cameras: Cameras
    depths: Float[Tensor, "batch view height width"] | None  # true camera z
    # as a matcher would give it, where the data has depths
    geometry: Geometry | None
    # where an edit may have added or removed something, so that `depths` tell nothing of the truth;
    # None: nowhere
    reshaped: Bool[Tensor, "batch view height width"] | None = None

    def true_centres(self) -> Float[Tensor, "batch gaussian 3"] | None:
        """Surface points of all context pixels, view-major, row-major."""
        if self.depths is None:
            return None
        c2w = self.context_cameras.c2w
        return unproject(self.depths, self.source.intrinsics, c2w).flatten(1, 3)


Unit = Literal["matcher", "baseline"]
"""The length that is 1: any, as a simulated matcher's, or the distance from the first to the last
input camera.
"""

Match = Callable[[SceneSample, np.random.Generator], SimulatedMatch]
"""What is said of the geometry of a sample that comes with depths."""


def make_batch(
    samples: Sequence[SceneSample],
    shares: RegimeShares,
    generators: Sequence[np.random.Generator],
    unit: Unit = "matcher",
    match: Match = simulate_match,
) -> TrainingBatch:
    """Edit every sample by its own random numbers; `match` says what a matcher would."""
    batches = [
        _batch_of_one(sample, shares, rng, unit, match)
        for sample, rng in zip(samples, generators)
    ]
    return _joined(*batches)


def _batch_of_one(
    sample: SceneSample,
    shares: RegimeShares,
    rng: np.random.Generator,
    wished_unit: Unit,
    match_as: Match,
) -> TrainingBatch:
    """The batch of one scene."""
    edit, depths = edit_sample(sample, shares, rng), sample.context_depths
    geometry, unit = None, 1.0
    if wished_unit == "baseline":
        baseline = float(sample.context_cameras.c2w[0, -1, :3, 3].norm())
        unit = 1 / max(baseline, 1e-9)
    elif depths is not None:
        match = match_as(sample, rng)
        # The matcher cannot know the scene's own unit.
        geometry, unit = match.geometry, match.unit

    def scaled(cameras: Cameras) -> Cameras:
        return replace(cameras, c2w=scale_poses(cameras.c2w, unit))

    intrinsics = sample.context_cameras.intrinsics
    return TrainingBatch(
        source=Views(sample.context[None], intrinsics),
        edited=Views(edit.edited[None], intrinsics),
        truth=edit.truth[None],
        target=edit.target[None],
        context_cameras=scaled(sample.context_cameras),
        target_cameras=scaled(sample.target_cameras),
        depths=None if depths is None else depths[None] * unit,
        geometry=geometry,
        reshaped=_reshaped(edit, sample.context)[None],
    )


def _reshaped(
    edit: EditedSample, photos: Float[Tensor, "view 3 height width"]
) -> Bool[Tensor, "view height width"]:
    """Where the truth shows something else than the photos, and it may be another surface."""
    return ((edit.truth - photos).abs().amax(1) > OTHER_SURFACE) & edit.reshaped


def _joined(*values: Any) -> Any:
    """Equal data classes as one, their tensors joined along the batch."""
    first = values[0]
    if isinstance(first, Tensor):
        return torch.cat(values)
    if not isinstance(first, Tensors):
        return first
    names = [field.name for field in fields(first)]
    return replace(
        first, **{n: _joined(*(getattr(one, n) for one in values)) for n in names}
    )
