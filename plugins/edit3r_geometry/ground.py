"""The ground that a scene stands on: level, and below everything that was measured.

Lawns, gravel and streets are seldom measured: they lie nearer than all features, and look alike
everywhere. Where what was measured ends at one height in nearly every column of all photos, as the
foot of a house does, the ground begins there, and no guess may lie below it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

from edit3r.kit.geometry.cameras import up_direction
from edit3r_geometry.cameras import CalibratedImage, Pose, pixel_rays
from edit3r_geometry.plane_sweep import RawDepth

MIN_BELOW = 0.05  # of a photo is free below what was measured [its height]
# Share of all columns that end so: 0.74 to 0.97 before houses, 0.57 at the trunk of a tree
MIN_SHARE = 0.6
# Median distance of the ends' heights from their own median [height of the lowest camera above it]
MAX_SPREAD = 0.15
MIN_UPRIGHT = 0.7  # cosine of the angle between a photo's own up and the scene's


@dataclass(frozen=True)
class Ground:
    """A level plane: the points `x` with `up @ x == height`."""

    up: Float[np.ndarray, "3"]
    height: float


def find_ground(
    images: Sequence[CalibratedImage],
    poses: Sequence[Pose],
    raw: Mapping[int, RawDepth],
    measured: Mapping[int, Bool[np.ndarray, "height width"]],
) -> Ground | None:
    """The ground below what was `measured`, in the frame of the `poses` (world to camera); None
    where the photos do not agree on one.

    `raw` and `measured` are of the views that were placed.
    """
    to_world = {view: poses[view].inverse() for view in raw}
    c2w = np.stack([pose.matrix for pose in to_world.values()])
    up = up_direction(torch.from_numpy(c2w).float()).double().numpy()
    feet, eyes, columns = [], [], 0
    for view, pose in to_world.items():
        columns += measured[view].shape[1]
        if -up @ pose.rotation[:, 1] < MIN_UPRIGHT:
            continue
        eyes.append(float(pose.translation @ up))
        row, column = _lowest(measured[view])
        rays = pixel_rays(images[view].intrinsics, images[view].size)[row, column]
        points = pose.apply(rays / raw[view].inverse[row, column][:, None])
        feet.extend(points @ up)
    if len(feet) < MIN_SHARE * columns:
        return None
    height = float(np.median(feet))
    spread = float(np.median(np.abs(np.array(feet) - height)))
    agree = spread < MAX_SPREAD * (min(eyes) - height)
    return Ground(up, height) if agree else None


def above_ground(
    inverse: Float[np.ndarray, "height width"],
    measured: Bool[np.ndarray, "height width"],
    image: CalibratedImage,
    pose: Pose,
    ground: Ground,
) -> Float[np.ndarray, "height width"]:
    """`inverse` depth with each guess that lies below the ground lifted onto it; what was
    `measured` stays.

    `pose` brings points of the ground's frame into the camera's.
    """
    to_world = pose.inverse()
    falls = -(pixel_rays(image.intrinsics, image.size) @ (pose.rotation @ ground.up))
    above = to_world.translation @ ground.up - ground.height
    lifted = np.maximum(inverse, falls / above)
    return np.where(measured, inverse, lifted).astype(np.float32)


def _lowest(
    measured: Bool[np.ndarray, "height width"],
) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the lowest measured pixel of each column that is free below it."""
    height = len(measured)
    lowest = height - 1 - measured[::-1].argmax(0)
    (column,) = np.nonzero(measured.any(0) & (lowest < (1 - MIN_BELOW) * height))
    return lowest[column], column
