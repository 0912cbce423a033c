"""What the depth network learns from: scenes with true depth, seen through poses that are wrong as found ones are.

Registration makes small errors that its own matches cannot tell: rotation and translation err together, along the
epipolar lines of the features. So the poses of a sample are fitted to true matches with noise, as registration fits
them to found ones, with slightly wrong intrinsics. The depth that is right is then what these poses make of the true
match: no depth explains the images better.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import SceneSample
from edit3r_matching.cameras import CalibratedImage, Pose, pixel_rays, project, rays_through, triangulate
from edit3r_matching.depth_maps import inverse_depth_range
from edit3r_matching.depth_network import STRIDE, cell_costs, cell_grids
from edit3r_matching.plane_sweep import Neighbour, matching_cost
from edit3r_matching.relative_pose import Matches, pose_fitted_once
from edit3r_matching.semi_global import aggregate

MATCHES = 60
"""True matches that a sample's pose is fitted to."""


@dataclass(frozen=True)
class Wrongness:
    """How far a sample is from the clean scene; 0: not at all."""

    matches: float = 2.0  # most noise of the matches that poses are fitted to [pixels]
    focal: float = 0.04  # most relative error of the focal length
    exposure: float = 0.25  # gain, bias and gamma of each view
    noise: float = 0.03  # most [sRGB]


@dataclass(frozen=True)
class DepthBatch:
    """B views with their neighbours, as the network takes them, and what is true."""

    images: Float[Tensor, "batch view 3 height width"]
    grids: Float[Tensor, "batch other plane h w 2"]
    classical: Float[Tensor, "batch 3 plane h w"]
    truth: Float[Tensor, "batch plane h w"]  # share of each cell's pixels that lie on each plane; 0 where unknown
    inverse_depths: Float[Tensor, "batch plane"]
    depth: Float[Tensor, "batch height width"]  # inverse, of each pixel; NaN where unknown


def batch_of(
    samples: Sequence[SceneSample], rng: np.random.Generator, how: Wrongness, planes: tuple[int, int]
) -> DepthBatch:
    """One batch; number of neighbours and of planes are drawn for all of it."""
    count, views = int(rng.integers(*planes, endpoint=True)), samples[0].context.shape[0]
    others = 1 if rng.random() < 0.75 else min(2, views - 1)
    rows = [_row(sample, rng, how, count, others) for sample in samples]
    return DepthBatch(*(torch.from_numpy(np.stack(values)) for values in zip(*rows)))


def _row(sample: SceneSample, rng: np.random.Generator, how: Wrongness, planes: int, others: int) -> tuple:
    """The fields of `DepthBatch` for one sample, whose first view and neighbours are drawn."""
    order = rng.permutation(sample.context.shape[0])[: others + 1]
    true, depth = _scene(sample, order)
    bend = float(np.exp(rng.uniform(-1, 1) * how.focal)) if rng.random() < 0.5 else 1.0
    channels = rng.permutation(3)
    shown = [_exposed(image, rng, how, channels, bend) for image, _ in true]
    reference, pose = shown[0], true[0][1]
    spread = how.matches * rng.random() ** 2
    neighbours, inverse = [], []
    for image, (clean, there) in zip(shown[1:], true[1:]):
        move = there.after(pose.inverse())
        found = _found_pose(true[0][0], clean, move, depth, bend, spread, rng)
        neighbours.append(Neighbour(image, found))
        inverse.append(_explained(true[0][0], clean, move, depth, reference, image, found))
    inverse = np.nanmean(np.stack(inverse), axis=0) if np.isfinite(inverse).any() else inverse[0]
    hypotheses = np.linspace(*_searched(inverse, rng), planes)
    cost = matching_cost(reference, neighbours, hypotheses)
    total = aggregate(cost, reference.grey)
    return (
        np.stack([image.pixels.transpose(2, 0, 1) for image in shown]),
        cell_grids(reference, neighbours, hypotheses),
        cell_costs(cost, total),
        on_planes(inverse, hypotheses),
        hypotheses.astype(np.float32),
        inverse.astype(np.float32),
    )


def _scene(
    sample: SceneSample, order: Sequence[int]
) -> tuple[list[tuple[CalibratedImage, Pose]], Float[np.ndarray, "height width"]]:
    """Images and world-to-camera poses in this order, and the first one's depth."""
    height, width = sample.context.shape[-2:]
    cameras, found = sample.context_cameras, []
    for view in order:
        image = np.ascontiguousarray(sample.context[view].permute(1, 2, 0).numpy())
        k = cameras.intrinsics[0, view].double().numpy() * np.array([[width], [height], [1.0]])
        found.append((CalibratedImage(image, k), Pose.from_matrix(cameras.c2w[0, view].double().numpy()).inverse()))
    return found, sample.context_depths[order[0]].double().numpy()


def _exposed(
    image: CalibratedImage, rng: np.random.Generator, how: Wrongness, channels: np.ndarray, bend: float
) -> CalibratedImage:
    """The image in another exposure, with noise, blur and compression by chance, and a focal length that is off."""
    gain, bias, gamma = rng.uniform(-1, 1, 3) * how.exposure * rng.random()
    pixels = np.clip((1 + 0.8 * gain) * image.pixels[:, :, channels] + 0.4 * bias, 0, 1) ** np.exp(gamma)
    if rng.random() < 0.4:
        pixels = cv2.GaussianBlur(pixels, (0, 0), rng.uniform(0.3, 1.0))
    pixels = np.clip(pixels + rng.normal(size=pixels.shape) * how.noise * rng.random() ** 2, 0, 1)
    if rng.random() < 0.5:
        quality = int(rng.integers(50, 96))
        coded = cv2.imencode(".jpg", (pixels * 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        pixels = cv2.imdecode(coded, cv2.IMREAD_COLOR) / 255
    focal = np.diag([bend, bend, 1.0])
    k = image.intrinsics.copy()
    k[:2, :2] = k[:2, :2] @ focal[:2, :2]
    return CalibratedImage(np.ascontiguousarray(pixels, np.float32), k)


def _found_pose(a, b, move: Pose, depth, bend: float, spread: float, rng: np.random.Generator) -> Pose:
    """What registration would find from matches with this noise; `move` where there are too few."""
    height, width = a.size
    y, x = rng.integers(height, size=400), rng.integers(width, size=400)
    points = np.stack([x, y], 1) + 0.5
    there = move.apply(rays_through(points, a.intrinsics) * depth[y, x, None])
    matched = project(there, b.intrinsics)
    seen = (there[:, 2] > 0) & (matched > 0).all(1) & (matched < (b.size[1], b.size[0])).all(1)
    if seen.sum() < 20:
        return move
    kept = np.flatnonzero(seen)[:MATCHES]
    stretch = np.array([[bend], [bend], [1.0]])
    wrong_a, wrong_b = (np.where(np.eye(3) > 0, k * stretch, k) for k in (a.intrinsics, b.intrinsics))
    noisy = matched[kept] + rng.normal(size=(len(kept), 2)) * spread
    rays = (rays_through(points[kept], wrong_a), rays_through(noisy, wrong_b))
    return pose_fitted_once(Matches(*rays, float(wrong_a[0, 0]), 1.0), move)


def _explained(a, b, move: Pose, depth, shown_a, shown_b, found: Pose) -> Float[np.ndarray, "height width"]:
    """Inverse depth that the found pose makes of each pixel's true match; NaN where it makes none."""
    there = move.apply(pixel_rays(a.intrinsics, a.size) * depth[..., None])
    matched = project(there, b.intrinsics).reshape(-1, 2)
    rays = pixel_rays(shown_a.intrinsics, a.size).reshape(-1, 3)
    near, far = triangulate(rays, rays_through(matched, shown_b.intrinsics), found)
    good = (near > 0) & (far > 0) & (there[..., 2].ravel() > 0)
    return np.where(good, 1 / np.where(good, near, 1), np.nan).reshape(a.size)


def _searched(inverse: Float[np.ndarray, "height width"], rng: np.random.Generator) -> tuple[float, float]:
    """The range that a reconstruction would search, from the depths of some pixels."""
    known = inverse[np.isfinite(inverse)]
    some = rng.choice(known, 150) if len(known) else np.array([0.5, 1.0])
    return inverse_depth_range(1 / some)


def on_planes(
    inverse: Float[np.ndarray, "height width"], hypotheses: Float[np.ndarray, "plane"]
) -> Float[np.ndarray, "plane h w"]:
    """Share of each cell's pixels on each plane, linear between two planes; pixels beyond the range count nowhere."""
    height, width = inverse.shape
    step = hypotheses[1] - hypotheses[0]
    position = (inverse - hypotheses[0]) / step
    known = np.isfinite(position) & (position >= 0) & (position <= len(hypotheses) - 1)
    y, x = np.nonzero(known)
    low = np.minimum(position[known].astype(int), len(hypotheses) - 2)
    part = position[known] - low
    shares = np.zeros((len(hypotheses), height // STRIDE, width // STRIDE), np.float32)
    np.add.at(shares, (low, y // STRIDE, x // STRIDE), (1 - part) / STRIDE**2)
    np.add.at(shares, (low + 1, y // STRIDE, x // STRIDE), part / STRIDE**2)
    return shares
