"""From raw depth to a complete map: keep what neighbours confirm, fill in the rest, hide no sky."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from edit3r.kit.compute.layers import weighted_smooth
from edit3r_geometry.cameras import CalibratedImage, pixel_rays, project
from edit3r_geometry.plane_sweep import Neighbour, RawDepth

# The numbers of this block: no figures kept.
AGREEMENT = 1.5  # planes by which two measurements of one surface may differ
REACH = 2000.0  # smoothness weight of the fill: a gap of some fifty pixels is bridged
TOUCH = 15.0  # and for smoothing what was measured
# 8-bit colour differences at which the smoothness falls to 1/e
COLOUR, TOUCH_COLOUR = 6.0, 8.0
# distance from the nearest measured pixel up to which its depth is taken [long sides]
BESIDE = 1 / 16
# but not where spreading says that much farther: next to a depth edge the background goes on
BEHIND = 0.05
TRUST_IN_GUESSES = 1e-6  # of unconfirmed depths where confirmed ones are far away
TRUST_NEARBY = 1e-4
LEAST_FOR_A_PLANE = 50  # measured pixels
PLANE_SAMPLES = 4000
PLANE_ROUNDS = 15
# Relative difference in depth from which a point stands before a surface.
IN_FRONT = 0.03
NEARER = 1.1  # ratio of inverse depths of two steps towards the camera
# After the steps once more by this, so that views between the photos look past it too: 1 costs
# 0.8 dB there.
WELL_NEARER = 3.0
MAX_STEPS = 40  # to 1/45 of its depth


def confirmed(
    inverse: Float[np.ndarray, "height width"],
    reference: CalibratedImage,
    neighbour: Neighbour,
    other: RawDepth,
) -> Bool[np.ndarray, "height width"]:
    """Pixels of depth `inverse` where the neighbour, by its `other`, measured the same surface."""
    points = neighbour.pose.apply(
        pixel_rays(reference.K, reference.size) / inverse[..., None]
    )
    depth = points[..., 2]
    pixels = project(points, neighbour.image.K).astype(np.float32) - np.float32(0.5)
    # -1 is read outside the neighbour's image.
    seen = cv2.remap(  # type: ignore[call-overload]  # pairs need no second map
        other.inverse,
        pixels,
        None,
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=-1.0,
    )
    inside = (depth > 0) & (seen > 0)
    difference = 1 / np.where(inside, depth, 1) - seen
    return inside & (np.abs(difference) < AGREEMENT * other.step)


def without_speckles(
    agrees: Bool[np.ndarray, "height width"], raw: RawDepth
) -> Bool[np.ndarray, "height width"]:
    """`agrees` without lone pixels and small islands of one depth, which agree by chance."""
    height, width = agrees.shape
    # the two anchors are opposite corners, or what is kept would move by a pixel
    square = np.ones((2, 2), np.uint8)
    eroded = cv2.erode(
        agrees.astype(np.uint8),
        square,
        anchor=(1, 1),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    kept = cv2.dilate(eroded, square, anchor=(0, 0)) > 0
    quarter_planes = np.clip(
        (raw.inverse - raw.inverse.min()) / raw.step * 4 + 16, 1, 32000
    ).astype(np.int16)
    quarter_planes[~kept] = 0
    cv2.filterSpeckles(quarter_planes, 0, max(12, height * width // 1200), 6)
    return kept & (quarter_planes > 0)


def fill(
    inverse: Float[np.ndarray, "height width"],
    measured: Bool[np.ndarray, "height width"],
    step: float,
    image: Float[np.ndarray, "height width 3"],
) -> Float[np.ndarray, "height width"]:
    """Inverse depth everywhere: `inverse` lightly smoothed where `measured`, continued from there
    elsewhere.

    Close to something measured the nearest pixel's depth, farther away what fast global smoothing
    (Min et al. 2014) spreads: flat colour carries depth, edges stop it. `step` is how far apart two
    hypotheses were: smoothing by more would blur a depth edge.
    """
    guide = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    median = cv2.medianBlur(inverse, 3)
    weight = measured.astype(np.float32)
    base, limits = main_plane(median, measured)
    spread = base + weighted_smooth(
        median - base, weight + np.float32(TRUST_IN_GUESSES), guide, REACH, COLOUR
    )
    smooth = weighted_smooth(
        median, weight + np.float32(TRUST_NEARBY), guide, TOUCH, TOUCH_COLOUR
    )
    touched = np.where(np.abs(smooth - median) < step, 0.5 * (smooth + median), median)
    spread = np.clip(spread, *limits)
    beside, distance = _nearest(median, measured)
    taken = (distance < BESIDE * max(measured.shape)) & (beside < (1 + BEHIND) * spread)
    return np.where(measured, touched, np.where(taken, beside, spread)).astype(
        np.float32
    )


def _nearest(
    values: Float[np.ndarray, "height width"],
    measured: Bool[np.ndarray, "height width"],
) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
    """The value of the nearest measured pixel, and the distance to it (large: there is none)."""
    gaps = (~measured).astype(np.uint8)
    distance, labels = cv2.distanceTransformWithLabels(
        gaps, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(labels.max() + 1, values.dtype)
    of_label[labels[measured]] = values[measured]
    return of_label[labels], distance


def main_plane(
    inverse: Float[np.ndarray, "height width"],
    measured: Bool[np.ndarray, "height width"],
) -> tuple[Float[np.ndarray, "height width"], tuple[float, float]]:
    """The plane nearest to most of what was measured, as inverse depth everywhere, and the range
    that was measured.

    Planes are linear in inverse depth. Far from anything measured the filling returns to this one:
    often the ground or a wall that goes on outside the overlap of the photos. Iteratively
    reweighted least squares (Cauchy).
    """
    index = np.flatnonzero(measured)
    if len(index) < LEAST_FOR_A_PLANE:
        return np.full_like(inverse, np.median(inverse)), (
            float(inverse.min()),
            float(inverse.max()),
        )
    height, width = inverse.shape
    y, x = np.mgrid[:height, :width]
    basis = np.stack(
        [x.ravel() / width - 0.5, y.ravel() / height - 0.5, np.ones(x.size)], axis=1
    )
    some = index[:: max(1, len(index) // PLANE_SAMPLES)]
    values, weights = inverse.ravel()[some].astype(float), np.ones(len(some))
    scale = 0.3 * values.std() + 1e-9
    for _ in range(PLANE_ROUNDS):
        solution = np.linalg.lstsq(
            basis[some] * weights[:, None], values * weights, rcond=None
        )[0]
        weights = 1 / (1 + ((values - basis[some] @ solution) / scale) ** 2)
    low, high = np.percentile(values, [0.5, 99.5])
    return (basis @ solution).reshape(inverse.shape).astype(np.float32), (low, high)


def pull_forward(
    inverse: Float[np.ndarray, "height width"],
    guessed: Bool[np.ndarray, "height width"],
    reference: CalibratedImage,
    others: Sequence[tuple[Neighbour, Float[np.ndarray, "height2 width2"]]],
) -> Float[np.ndarray, "height width"]:
    """`inverse` with guesses that hide a sky moved towards the camera, until they hide nothing.

    Nothing lies behind a sky: what stands before it in this photo alone, such as a branch, is so
    near that the other photos look past it. `others` come with the inverse depth of what each shows
    (0: sky, negative: nothing is known). A guess stays where it is if no place is free.
    """
    row, column = np.nonzero(guessed)
    rays = pixel_rays(reference.K, reference.size)[row, column]
    depth = 1 / inverse[row, column]
    hides_sky = np.zeros(len(row), bool)
    for neighbour, shown in others:
        hides_sky |= _shown_behind(rays * depth[:, None], neighbour, shown) == 0
    row, column = row[hides_sky], column[hides_sky]
    rays, depth = rays[hides_sky], depth[hides_sky]
    result = inverse.copy()
    for _ in range(MAX_STEPS):
        depth = depth / NEARER
        hides = np.zeros(len(row), bool)
        for neighbour, shown in others:
            hides |= _shown_behind(rays * depth[:, None], neighbour, shown) >= 0
        result[row[~hides], column[~hides]] = WELL_NEARER / depth[~hides]
        row, column = row[hides], column[hides]
        rays, depth = rays[hides], depth[hides]
    return result


def _shown_behind(
    points: Float[np.ndarray, "point 3"],
    neighbour: Neighbour,
    shown: Float[np.ndarray, "height width"],
) -> Float[np.ndarray, "point"]:
    """Inverse depth that the neighbour shows behind points of the reference's frame; -1 where it
    shows nothing, or nothing behind them.
    """
    there = neighbour.pose.apply(points)
    pixels = np.floor(project(there, neighbour.image.K))
    height, width = shown.shape
    inside = ((pixels >= 0) & (pixels < (width, height))).all(1)
    seen = np.full(len(points), -1, np.float32)
    column, row = pixels[inside].astype(int).T
    seen[inside] = shown[row, column]
    depth = there[:, 2]
    behind = (depth > 0) & (seen * depth < 1 - IN_FRONT)
    return np.where(behind, seen, -1)
