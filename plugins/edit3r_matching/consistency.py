"""Do two depth maps tell the same story? The check that separates what was measured from what was guessed."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_opening

from edit3r_matching.camera import Picture, pixel_rays, project
from edit3r_matching.depth_map import RawDepth
from edit3r_matching.plane_sweep import Neighbour

__all__ = ["CrossCheck", "cross_check", "without_speckles"]

_NOWHERE = -1.0  # inverse depth read outside the neighbour's picture


@dataclass(frozen=True)
class CrossCheck:
    """How each pixel of a picture looks from a neighbour, `[height, width]` bool."""

    agrees: np.ndarray  # the neighbour saw the same surface there
    behind: np.ndarray  # the neighbour saw something nearer: the pixel is hidden from it
    before: np.ndarray  # the neighbour looked through the pixel at something farther


def cross_check(
    inverse: np.ndarray, reference: Picture, neighbour: Neighbour, other: RawDepth, tolerance: float
) -> CrossCheck:
    """Move every pixel to the neighbour and compare inverse depths there; `tolerance` counts the other's planes."""
    points = neighbour.pose.apply(pixel_rays(reference.intrinsics, reference.size) / inverse[..., None])
    depth = points[..., 2]
    places = project(points, neighbour.picture.intrinsics).astype(np.float32) - np.float32(0.5)
    seen = cv2.remap(
        other.inverse, places, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=_NOWHERE
    )
    inside = (depth > 0) & (seen > 0)
    difference = 1 / np.where(inside, depth, 1) - seen
    limit = tolerance * other.step
    return CrossCheck(
        inside & (np.abs(difference) < limit), inside & (difference < -limit), inside & (difference > limit)
    )


def without_speckles(agrees: np.ndarray, raw: RawDepth) -> np.ndarray:
    """`agrees` without lone pixels and small islands of one depth, which agree by chance."""
    height, width = agrees.shape
    kept = binary_opening(agrees, np.ones((2, 2)))
    quarter_planes = np.clip((raw.inverse - raw.inverse.min()) / raw.step * 4 + 16, 1, 32000).astype(np.int16)
    quarter_planes[~kept] = 0
    cv2.filterSpeckles(quarter_planes, 0, max(12, height * width // 1200), 6)
    return kept & (quarter_planes > 0)
