"""What a matcher would say about a scene whose true geometry is known: its typical errors on the
true depth and pose.

Training needs geometry thousands of times a minute, far more often than photos can be matched.
Simulated are: parts hidden in the other view and patches without texture (filled in from their
surroundings, confidence 0), steps of the depth hypotheses, foreground that spills over its border,
confident outliers, pose noise and an unknown unit.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher, SceneSample
from edit3r.contract.types import Views
from edit3r.kit import asking
from edit3r.kit.compute.layers import weighted_smooth
from edit3r.kit.geometry.cameras import project, unproject

Map = Float[np.ndarray, "height width"]
Where = Bool[np.ndarray, "height width"]
Image = Float[np.ndarray, "height width 3"]  # sRGB in [0, 1]


@dataclass(frozen=True)
class SimulatedMatch:
    """Geometry with a matcher's errors and unit: `depths = true depths * unit` but for them."""

    geometry: Geometry  # batch 1
    unit: float


def simulate_match(sample: SceneSample, rng: np.random.Generator) -> SimulatedMatch:
    """A plausible matcher's answer for the sample's context views (which must come with depths)."""
    cameras, true_depths = sample.context_cameras, sample.context_depths
    assert true_depths is not None  # see above
    unit = float(np.exp(rng.uniform(-1, 1)))
    severity = rng.uniform(0.3, 1.5)
    visible = seen_by_partner(
        true_depths, cameras.c2w[0], cameras.intrinsics[0]
    ).numpy()
    depths, confidence = [], []
    for view in range(len(true_depths)):
        image = sample.context[view].permute(1, 2, 0).numpy()
        inverse, measured = _corrupted(
            1 / true_depths[view].numpy(), visible[view], image, rng, severity
        )
        depths.append(unit / inverse)
        confidence.append(measured.astype(np.float32))
    c2w = cameras.c2w.clone()
    for view in range(1, len(true_depths)):
        c2w[0, view] = torch.from_numpy(
            _noisy_pose(cameras.c2w[0, view].double().numpy(), rng, severity)
        ).float()
    c2w[:, :, :3, 3] *= unit
    geometry = Geometry(
        c2w=c2w,
        depths=torch.from_numpy(np.stack(depths)).float()[None],
        confidence=torch.from_numpy(np.stack(confidence))[None],
        registered=torch.ones(1, len(true_depths), dtype=torch.bool),
    )
    return SimulatedMatch(geometry, unit)


def really_match(sample: SceneSample, matcher: Matcher) -> SimulatedMatch | None:
    """The matcher's answer for the sample's context views; None where it does not place all."""
    try:
        views = Views(sample.context[None], sample.context_cameras.intrinsics)
        geometry = asking.find_geometry(matcher, views)
    except MatchingError:
        return None
    matched, true = (
        c2w[0, -1, :3, 3].norm() for c2w in (geometry.c2w, sample.context_cameras.c2w)
    )
    return (
        SimulatedMatch(geometry, float(matched / true))
        if bool(geometry.registered.all())
        else None
    )


def seen_by_partner(
    depths: Float[Tensor, "view height width"],
    c2w: Float[Tensor, "view 4 4"],
    intrinsics: Float[Tensor, "view 3 3"],
    tolerance: float = 0.03,
) -> Bool[Tensor, "view height width"]:
    """Which pixels' surfaces the partner view sees too (view 0's partner is view 1, everyone else's
    view 0).

    A surface is hidden there when it lies more than `tolerance` (relative) behind what the partner
    sees.
    """
    index = [1] + [0] * (len(depths) - 1)
    height, width = depths.shape[1:]
    points = unproject(depths, intrinsics, c2w).reshape(len(depths), -1, 3)
    coordinates, z = project(points, intrinsics[index], c2w[index])
    column = (coordinates[..., 0] * width).floor().long()
    row = (coordinates[..., 1] * height).floor().long()
    inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    flat = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
    there = depths[index].flatten(1).gather(1, flat)
    return (inside & (z < there * (1 + tolerance))).reshape(depths.shape)


def _corrupted(
    true: Map, visible: Where, image: Image, rng: np.random.Generator, severity: float
) -> tuple[Map, Where]:
    """The `true` inverse depth as measured or filled in, and where it was measured."""
    low, high = np.percentile(true, [2, 98])
    step = max(high - low, 1e-3) / rng.integers(24, 96)
    spilled = cv2.dilate(true, np.ones((3, 3)), iterations=int(rng.integers(1, 3)))
    inverse = np.where(_blobs(rng, true.shape, 0.5), spilled, true)
    inverse = inverse * (1 + 0.012 * severity * _smooth_noise(rng, true.shape, 6))
    inverse = inverse + step * severity * (
        0.3 * rng.normal(size=true.shape) + 0.3 * _smooth_noise(rng, true.shape, 24)
    )
    outliers = _blobs(rng, true.shape, 0.02 * severity)
    inverse = np.where(outliers, rng.uniform(low, high), inverse)
    measured = (
        visible
        & ~_textureless(image, rng, severity)
        & ~_blobs(rng, true.shape, 0.05 * severity)
    )
    measured &= ~(outliers & (rng.random() < 0.5))
    measured &= ~((np.abs(spilled - true) > 2 * step) & (rng.random(true.shape) < 0.5))
    if measured.mean() < 0.05:
        measured = visible
    filled = _filled(inverse.clip(low * 0.7, high * 1.4), measured, image)
    return np.where(measured, inverse, filled).clip(low * 0.5, high * 1.6).astype(
        np.float32
    ), measured


def _filled(inverse: Map, measured: Where, image: Image) -> Map:
    """Inverse depth spread from what was measured along image edges (fast global smoother)."""
    guide = (image * 255).astype(np.uint8)
    weights = measured.astype(np.float32) + 1e-4
    return weighted_smooth(inverse.astype(np.float32), weights, guide, 2000.0, 6.0)


def _textureless(image: Image, rng: np.random.Generator, severity: float) -> Where:
    """Patches that a matcher finds nothing in, the likelier the less texture they have."""
    grey = image.mean(2)
    gradient = cv2.blur(np.abs(cv2.Laplacian(grey, cv2.CV_32F)), (5, 5))
    chance = np.exp(-gradient / (0.015 * severity))
    return _smooth_uniform(rng, grey.shape, 16) < 0.7 * chance


def _blobs(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Where:
    """Random smooth patches that cover about `share` of the image."""
    return _smooth_uniform(rng, shape, 12) < share


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, int], cells: int) -> Map:
    """Smooth random field of mean 0, variance about 1, `cells` independent values a side."""
    coarse = rng.normal(size=(cells, cells)).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC) * 1.3


def _smooth_uniform(
    rng: np.random.Generator, shape: tuple[int, int], cells: int
) -> Map:
    """Smooth random field with values spread about evenly over [0, 1]."""
    return 1 / (1 + np.exp(-1.7 * _smooth_noise(rng, shape, cells)))


def _noisy_pose(
    c2w: Float[np.ndarray, "4 4"], rng: np.random.Generator, severity: float
) -> Float[np.ndarray, "4 4"]:
    """Rotation and direction of translation off by tenths of a degree, now and then by more."""
    spread = np.deg2rad(0.25) * severity * (8 if rng.random() < 0.05 else 1)
    result = c2w.copy()
    result[:3, :3] = (
        c2w[:3, :3] @ Rotation.from_rotvec(rng.normal(size=3) * spread).as_matrix()
    )
    result[:3, 3] = (
        Rotation.from_rotvec(rng.normal(size=3) * 2 * spread).as_matrix() @ c2w[:3, 3]
    )
    return result
