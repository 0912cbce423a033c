"""A calm closed camera path through the input views, for videos."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import invert_rigid
from edit3r.kit.geometry.rotations import (
    cross_matrix,
    matrices_to_quats,
    quats_to_matrices,
)

__all__ = ["between_and_around", "half_way", "interpolate_poses"]

# The numbers of this block: no figures kept.
# how far the path leaves the straight way between two views, in distances between views
SIDE_STEP = 0.25
# but at least and at most this, in distances to the scene
SIDE_STEP_IN_DEPTHS = (0.01, 0.08)


def between_and_around(
    cameras: Cameras, frames: int, depth: float | None = None
) -> Cameras:
    """`frames` cameras on a loop from view 0 past every view and back, resting an instant at each.

    Between two views the camera follows the screw motion that joins them (an arc around what both
    look at, a line when they face the same way), swung a little up on the way out and down on the
    way back, so that the loop also goes around the views. `depth` is a typical distance to the
    scene [scene units]: it bounds the swing, and the camera turns to keep that distance in the
    middle; None: the swing is a share of the distance between the views. One view alone is circled;
    that needs `depth`. Frame 0 is view 0 exactly.
    """
    if frames < 1:
        raise ValueError(f"a path needs at least 1 frame, got {frames}")
    paths = [
        _one_scene(c2w, k, frames, depth)
        for c2w, k in zip(cameras.c2w.double(), cameras.intrinsics.double())
    ]
    poses, intrinsics = (
        torch.stack(part).to(cameras.c2w.dtype) for part in zip(*paths)
    )
    return Cameras(poses, intrinsics, cameras.image_size)


def interpolate_poses(
    start: Float[Tensor, "*batch 4 4"],
    end: Float[Tensor, "*batch 4 4"],
    share: Float[Tensor, "*batch"],
) -> Float[Tensor, "*batch 4 4"]:
    """Poses at `share` of the screw motion between two: start exp(share log(start^-1 end)).

    The logarithm of (R, t) is (w, V(w)^-1 t), where w is the rotation vector and V(w), the integral
    of exp(s [w]x) over s in [0, 1], is the upper right block of exp([[[w]x, I], [0, 0]]).
    """
    relative = invert_rigid(start) @ end
    twist = torch.zeros_like(relative)
    block = relative.new_zeros(*relative.shape[:-2], 6, 6)
    twist[..., :3, :3] = block[..., :3, :3] = cross_matrix(
        _rotation_vector(relative[..., :3, :3])
    )
    block[..., :3, 3:] = torch.eye(3, dtype=relative.dtype, device=relative.device)
    integral = torch.linalg.matrix_exp(block)[..., :3, 3:]
    twist[..., :3, 3:] = torch.linalg.solve(integral, relative[..., :3, 3:])
    return start @ torch.linalg.matrix_exp(share[..., None, None] * twist)


def half_way(cameras: Cameras) -> tuple[Cameras, tuple[tuple[int, int], ...]]:
    """Of one scene (batch 1): cameras half-way from each view to its nearest one, and between which
    two views each stands. A camera has the lens of its first view.
    """
    centres = cameras.c2w[0, :, :3, 3]
    apart = torch.cdist(centres, centres).fill_diagonal_(torch.inf)
    nearest = apart.argmin(1).tolist()
    pairs = tuple(sorted({(min(pair), max(pair)) for pair in enumerate(nearest)}))
    first, second = (cameras.c2w[:, list(side)].double() for side in zip(*pairs))
    poses = interpolate_poses(first, second, first.new_tensor(0.5))
    lenses = cameras.intrinsics[:, [pair[0] for pair in pairs]]
    return Cameras(poses.to(cameras.c2w), lenses, cameras.image_size), pairs


def _one_scene(
    c2w: Float[Tensor, "view 4 4"],
    intrinsics: Float[Tensor, "view 3 3"],
    frames: int,
    depth: float | None,
) -> tuple[Float[Tensor, "frame 4 4"], Float[Tensor, "frame 3 3"]]:
    """Poses and intrinsics of the path through one scene's views."""
    order = _short_tour(c2w[:, :3, 3])
    views = len(order)
    position = torch.arange(frames, dtype=c2w.dtype, device=c2w.device) * (
        views / frames
    )
    leg = position.floor().long().clamp(max=views - 1)
    begin, end = order[leg], order[(leg + 1) % views]
    share = position - leg
    share = share * share * (3 - 2 * share)  # smoothstep: at rest at every view
    poses = interpolate_poses(c2w[begin], c2w[end], share)
    between = torch.lerp(intrinsics[begin], intrinsics[end], share[:, None, None])
    steps = (c2w[order, :3, 3] - c2w[order.roll(-1), :3, 3]).norm(dim=-1)
    swing = _swing(float(steps.mean()), depth)
    if views == 1:
        turn = 2 * math.pi * position
        offsets = swing * torch.stack((torch.sin(turn), torch.cos(turn) - 1), -1)
    else:
        # Up (y is down) on the first half of the loop, down on the second.
        sign = torch.where(leg < views / 2, -1.0, 1.0).to(c2w.dtype)
        offsets = swing * torch.stack(
            (torch.zeros_like(share), sign * torch.sin(math.pi * share)), -1
        )
    return poses @ _side_step(offsets, depth), between


def _short_tour(centres: Float[Tensor, "view 3"]) -> Int[Tensor, "view"]:
    """Views in the order of a walk that always goes to the nearest one left, from view 0."""
    left = list(range(1, len(centres)))
    order = [0]
    while left:
        nearest = min(
            left, key=lambda view: float((centres[view] - centres[order[-1]]).norm())
        )
        left.remove(nearest)
        order.append(nearest)
    return torch.tensor(order, device=centres.device)


def _swing(step: float, depth: float | None) -> float:
    """How far the path leaves the straight way, for views `step` apart [scene units]."""
    swing = SIDE_STEP * step
    if depth is None:
        return swing
    least, most = (share * depth for share in SIDE_STEP_IN_DEPTHS)
    # A lone view, or views all in one place, has no step to go by.
    return min(max(swing, least), most) if step > 0 else 0.5 * most


def _side_step(
    offsets: Float[Tensor, "frame 2"], depth: float | None
) -> Float[Tensor, "frame 4 4"]:
    """Camera-frame motions by (x, y) that keep the point ahead at `depth` in the image's middle."""
    motion = torch.eye(4, dtype=offsets.dtype, device=offsets.device).repeat(
        len(offsets), 1, 1
    )
    motion[:, :2, 3] = offsets
    if depth is not None:
        x, y = (-offsets).unbind(-1)
        ahead = torch.full_like(x, depth)
        length = torch.sqrt(x * x + y * y + ahead * ahead)
        # Shortest rotation of (0, 0, 1) to (x, y, depth): quaternion (1 + cos, axis sin),
        # normalised when used.
        motion[:, :3, :3] = quats_to_matrices(
            torch.stack((length + ahead, -y, x, torch.zeros_like(x)), -1)
        )
    return motion


def _rotation_vector(
    matrices: Float[Tensor, "*batch 3 3"],
) -> Float[Tensor, "*batch 3"]:
    """Axis times angle in [0, pi] of rotation matrices."""
    quats = matrices_to_quats(matrices)
    half_sine = quats[..., 1:].norm(dim=-1, keepdim=True)
    factor = 2 * torch.atan2(half_sine, quats[..., :1]) / half_sine.clamp(min=1e-12)
    return quats[..., 1:] * torch.where(half_sine > 1e-12, factor, 2.0)
