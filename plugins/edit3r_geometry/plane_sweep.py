"""Photo-consistency of depth hypotheses: neighbours are warped by the homography of each
fronto-parallel plane.

The cost of a pixel at a plane mixes normalised cross-correlation in two windows (blind to
brightness, sharp and robust) with the colour difference (tells flat regions apart), as a number of
about [0, 1].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from edit3r.kit.compute.compiling import compiled
from edit3r_geometry.cameras import CalibratedImage, Pose, pixel_rays, project

# The numbers of this block: no figures kept.
SMALL, LARGE = 1, 3  # radii of the correlation windows [pixels]
SMALL_WEIGHT, LARGE_WEIGHT, COLOUR_WEIGHT = 0.25, 0.45, 0.3
# colour differences above it cost no more: they are occlusions or highlights
COLOUR_LIMIT = 0.15
UNSEEN_COST = 0.5  # a hypothesis outside the neighbour's image is neither good nor bad
# Share of the worst cost that does not count, by the number of neighbours; of more: all.
WITHOUT_WORST = {1: 0.0, 2: 0.5}
TO_CENTRES = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
FROM_CENTRES = np.linalg.inv(TO_CENTRES)  # OpenCV counts from pixel centres
BLOCK = 16  # planes written to the volume together: one cache line


@dataclass(frozen=True)
class Neighbour:
    """Another image of the scene and where it was taken."""

    image: CalibratedImage
    pose: Pose  # reference frame to the neighbour's


@dataclass(frozen=True)
class RawDepth:
    """Inverse depth of every pixel as the sweep found it, before anything is checked."""

    inverse: Float[np.ndarray, "height width"]  # 1 / camera z, float32
    farthest: float  # inverse depth of the farthest plane of the sweep
    step: float  # inverse depth between two planes


def plane_inverse_depths(
    reference: CalibratedImage,
    neighbours: Sequence[Neighbour],
    inverse_range: tuple[float, float],
    limit: int,
) -> Float[np.ndarray, "plane"]:
    """Inverse depths spread evenly over `inverse_range`, about one pixel of motion apart.

    At most `limit`; the motion is the median over the image of the neighbour that moves most.
    """
    far, near = inverse_range
    rays = pixel_rays(reference.K, reference.size)[::16, ::16].reshape(-1, 3)
    motions = []
    for neighbour in neighbours:
        intrinsics = neighbour.image.K
        start, end = (
            project(neighbour.pose.apply(rays / inverse), intrinsics)
            for inverse in (far, near)
        )
        motions.append(np.median(np.linalg.norm(end - start, axis=1)))
    return np.linspace(far, near, int(np.clip(max(motions), 24, limit)))


def matching_cost(
    reference: CalibratedImage,
    neighbours: Sequence[Neighbour],
    inverse_depths: Float[np.ndarray, "plane"],
) -> Float[np.ndarray, "height width plane"]:
    """Cost of every plane at every pixel, float32: the mean over `neighbours`, of three and more
    without the worst, of two with half of it.

    What stands before a surface rarely hides it from all neighbours (Kang, Szeliski and Chai 2001,
    section 3.2).
    """
    planes = -(-len(inverse_depths) // BLOCK) * BLOCK
    volume = np.zeros((*reference.size, planes), np.float32)
    worst = np.zeros_like(volume if len(neighbours) > 1 else volume[:0])
    for neighbour in neighbours:
        _add_costs(volume, worst, reference, neighbour, inverse_depths)
    without = WITHOUT_WORST.get(len(neighbours), 1.0)
    if len(worst):
        worst *= without
        volume -= worst
    volume /= len(neighbours) - without
    return volume[:, :, : len(inverse_depths)]


def _add_costs(
    volume: Float[np.ndarray, "height width planes"],
    worst: Float[np.ndarray, "rows width planes"],
    reference: CalibratedImage,
    neighbour: Neighbour,
    inverse_depths: Float[np.ndarray, "plane"],
) -> None:
    """Add the neighbour's costs to a volume of multiples of BLOCK planes; `worst` may be empty."""
    grey = np.ascontiguousarray(reference.grey)
    statistics = [_statistics(grey, radius) for radius in (SMALL, LARGE)]
    block = np.empty((BLOCK, *reference.size), np.float32)
    to_rays = np.linalg.inv(reference.K)
    everywhere = np.ones(neighbour.image.size, np.uint8)
    for start in range(0, len(inverse_depths), BLOCK):
        for slot, inverse_depth in enumerate(inverse_depths[start : start + BLOCK]):
            homography = _homography(to_rays, neighbour, inverse_depth)
            warped, seen = (
                _warp(image, homography, reference.size, filtering)
                for image, filtering in (
                    (neighbour.image.pixels, cv2.INTER_LINEAR),
                    (everywhere, cv2.INTER_NEAREST),
                )
            )
            moments, difference = _moments(reference.pixels, grey, warped)
            small, large = _box(moments, SMALL), _box(moments, LARGE)
            _combine(
                small,
                *statistics[0],
                large,
                *statistics[1],
                _box(difference, 1),
                seen,
                block[slot],
            )
        _write_block(volume, worst, block, start)


def _homography(
    to_rays: Float[np.ndarray, "3 3"], neighbour: Neighbour, inverse_depth: float
) -> Float[np.ndarray, "3 3"]:
    """From the reference's pixels to the neighbour's if everything were at one depth."""
    motion = neighbour.pose.rotation + np.outer(
        neighbour.pose.translation, (0, 0, inverse_depth)
    )
    homography = neighbour.image.K @ motion @ to_rays
    return FROM_CENTRES @ homography @ TO_CENTRES


def _warp(
    image: Float[np.ndarray, "height width *channel"]
    | UInt8[np.ndarray, "height width"],
    homography: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
    filtering: int,
) -> np.ndarray:
    """The image by the homography, at `size`; what it does not hold repeats its border, or is 0
    where single pixels are taken.
    """
    border = cv2.BORDER_REPLICATE
    if filtering == cv2.INTER_NEAREST:
        border = cv2.BORDER_CONSTANT
    return cv2.warpPerspective(
        image,
        homography,
        size[::-1],
        flags=filtering | cv2.WARP_INVERSE_MAP,
        borderMode=border,
    )


def _statistics(
    grey: Float[np.ndarray, "h w"], radius: int
) -> list[Float[np.ndarray, "h w"]]:
    """Mean and variance over the window around each pixel."""
    mean = _box(grey, radius)
    return [mean, np.maximum(_box(grey * grey, radius) - mean * mean, 0)]


def _box(
    image: Float[np.ndarray, "h w *channel"], radius: int
) -> Float[np.ndarray, "h w *channel"]:
    """Mean over the window around each pixel."""
    return cv2.blur(
        image, (2 * radius + 1, 2 * radius + 1), borderType=cv2.BORDER_REFLECT
    )


@compiled(fastmath=True, nogil=True)
def _moments(image, grey, warped):  # pragma: no cover - compiled
    """Warped grey, its square and product with the reference, and truncated colour difference."""
    height, width = grey.shape
    moments = np.empty((height, width, 3), np.float32)
    difference = np.empty((height, width), np.float32)
    third, limit = np.float32(1 / 3), np.float32(COLOUR_LIMIT)
    for y in range(height):
        for x in range(width):
            r, g, b = warped[y, x, 0], warped[y, x, 1], warped[y, x, 2]
            value = (r + g + b) * third
            moments[y, x, 0] = value
            moments[y, x, 1] = value * value
            moments[y, x, 2] = value * grey[y, x]
            distance = (
                abs(image[y, x, 0] - r)
                + abs(image[y, x, 1] - g)
                + abs(image[y, x, 2] - b)
            ) * third
            difference[y, x] = min(distance, limit) / limit
    return moments, difference


@compiled(fastmath=True, nogil=True, inline="always")
def _correlation_cost(
    value, square, product, mean, variance
):  # pragma: no cover - compiled
    """1 - normalised cross-correlation, in [0, 1]; flat windows in both images agree weakly."""
    other = max(square - value * value, np.float32(0))
    norm = np.sqrt((variance + np.float32(4e-5)) * (other + np.float32(4e-5)))
    cost = np.float32(1) - (product - mean * value + np.float32(2e-5)) / norm
    return min(max(cost, np.float32(0)), np.float32(1))


@compiled(fastmath=True, nogil=True)
def _combine(
    small, mean_s, variance_s, large, mean_l, variance_l, colour, seen, out
):  # pragma: no cover - compiled
    height, width = out.shape
    weight_s, weight_l = np.float32(SMALL_WEIGHT), np.float32(LARGE_WEIGHT)
    weight_c, unseen = np.float32(COLOUR_WEIGHT), np.float32(UNSEEN_COST)
    for y in range(height):
        for x in range(width):
            near = _correlation_cost(
                small[y, x, 0],
                small[y, x, 1],
                small[y, x, 2],
                mean_s[y, x],
                variance_s[y, x],
            )
            wide = _correlation_cost(
                large[y, x, 0],
                large[y, x, 1],
                large[y, x, 2],
                mean_l[y, x],
                variance_l[y, x],
            )
            cost = weight_s * near + weight_l * wide + weight_c * colour[y, x]
            out[y, x] = cost if seen[y, x] else unseen


@compiled(nogil=True)
def _write_block(volume, worst, block, start):  # pragma: no cover - compiled
    """Add planes `[BLOCK, height, width]` to the volume from plane `start` on, pixel by pixel."""
    planes, height, width = block.shape
    for y in range(height):
        for x in range(width):
            for k in range(planes):
                volume[y, x, start + k] += block[k, y, x]
            if worst.shape[0]:
                for k in range(planes):
                    worst[y, x, start + k] = max(worst[y, x, start + k], block[k, y, x])
