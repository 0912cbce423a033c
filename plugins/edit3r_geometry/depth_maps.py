"""Depth of every pixel of every registered view: plane sweep, cross-check, completion, and back to
the images' size.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field

from edit3r.contract import reporting, settings as config
from edit3r.kit.compute.sky import coloured_like_sky, find_skies
from edit3r_geometry.cameras import CalibratedImage
from edit3r_geometry.completion import (
    confirmed,
    fill,
    pull_forward,
    without_speckles,
)
from edit3r_geometry.plane_sweep import (
    Neighbour,
    RawDepth,
    matching_cost,
    plane_inverse_depths,
)
from edit3r_geometry.registration import Registration
from edit3r_geometry.semi_global import aggregate, best_plane
from edit3r_geometry.upsampling import upsample_depth

# points of a pair that are not wrong together; chosen on `fox` 0, 8 (docs/notes/classical.md)
SEVERAL = 4
# times as near as most points, beyond which a point is wrong; by hand
NEAREST = 4.0
# Views whose sky is not to be hidden: those of a video say the same.
MAX_OTHERS = 8


class DepthSettings(config.Settings):
    """How finely depth is measured."""

    working_size: int = Field(160, ge=64, le=1024)
    """long side at which depth is measured [pixels]; time grows with its cube"""
    planes: int = Field(64, ge=24, le=512)
    """most depth hypotheses a pixel; fewer is quicker, coarser"""
    coarse: bool = False
    """measure at half the working size too, for what is not confirmed at the whole"""
    neighbours: int = Field(3, ge=1, le=8)
    """most views that help to measure the depth of one"""
    sky: bool = True
    """find the sky: what hides it in one photo alone is near that camera"""


def measure_depths(
    images: Sequence[CalibratedImage],
    registration: Registration,
    settings: DepthSettings,
) -> tuple[
    Float[np.ndarray, "view height width"], Float[np.ndarray, "view height width"]
]:
    """Inverse depth (1 / camera z) and confidence of every pixel, measured at the settings' working
    size.

    Confidence is 1 where two views measured the same surface, 0 where the depth was filled in.
    Views that are not registered get inverse depth 1 and confidence 0.
    """
    small = [image.reduced(settings.working_size) for image in images]
    raw, measured = _swept(small, registration, settings)
    if settings.coarse:
        half = [image.reduced(settings.working_size // 2) for image in images]
        rough, confirmed_there = _swept(half, registration, settings)
        for view in raw:
            raw[view], measured[view] = _with_coarse(
                raw[view], measured[view], rough[view], confirmed_there[view]
            )
    maps = [
        (np.ones(image.size, np.float32), np.zeros(image.size, np.float32))
        for image in images
    ]
    skies = find_skies([image.pixels for image in small]) if settings.sky else None
    for view in reporting.track(raw, "filling depth"):
        inverse = fill(
            raw[view].inverse, measured[view], raw[view].step, small[view].pixels
        )
        inverse = np.where(measured[view], inverse, cv2.medianBlur(inverse, 5))
        if skies is not None:
            inverse = _before_skies(
                inverse, view, small, registration, raw, measured, skies
            )
        maps[view] = upsample_depth(
            inverse, measured[view], small[view].pixels, images[view].pixels
        )
    depths, confidences = zip(*maps)
    return np.stack(depths), np.stack(confidences)


def _swept(
    images: Sequence[CalibratedImage],
    registration: Registration,
    settings: DepthSettings,
) -> tuple[
    dict[int, RawDepth],
    dict[int, Bool[np.ndarray, "height width"]],
]:
    """The depth of each registered view, and what its neighbours confirm of it."""
    around = [
        _neighbours(images, registration, view, settings.neighbours)
        for view in range(len(images))
    ]
    raw: dict[int, RawDepth] = {}
    for view in reporting.track(
        np.flatnonzero(registration.registered).tolist(), "measuring depth"
    ):
        depths = np.concatenate(
            [registration.shared_depths(view, other) for other in around[view]]
        )
        measuring = registration.measuring(view)
        raw[view] = sweep_depth(
            images[view],
            [near for other, near in around[view].items() if other in measuring],
            inverse_depth_range(depths, SEVERAL * len(around[view])),
            settings.planes,
        )
    measured = {view: _measured(images[view], around[view], view, raw) for view in raw}
    return raw, measured


def _with_coarse(
    raw: RawDepth,
    measured: Bool[np.ndarray, "height width"],
    coarse: RawDepth,
    measured_there: Bool[np.ndarray, "height2 width2"],
) -> tuple[RawDepth, Bool[np.ndarray, "height width"]]:
    """Depth and what was measured, with what only the coarse sweep measured: its windows are twice
    as large on the picture, so that they hold a pattern where small ones hold none.
    """
    size = raw.inverse.shape[::-1]
    inverse, there = (
        cv2.resize(part, size, interpolation=cv2.INTER_NEAREST)
        for part in (coarse.inverse, measured_there.astype(np.uint8))
    )
    only_there = (there > 0) & ~measured
    return (
        replace(raw, inverse=np.where(only_there, inverse, raw.inverse)),
        measured | only_there,
    )


def _before_skies(
    inverse: Float[np.ndarray, "height width"],
    view: int,
    images: Sequence[CalibratedImage],
    registration: Registration,
    raw: dict[int, RawDepth],
    measured: dict[int, Bool[np.ndarray, "height width"]],
    skies: Sequence[Bool[np.ndarray, "height width"]],
) -> Float[np.ndarray, "height width"]:
    """`inverse` of a view whose guesses hide the sky of no other view."""
    others = []
    around = _neighbours(images, registration, view, MAX_OTHERS)
    for other, neighbour in around.items():
        shown = np.where(measured[other], raw[other].inverse, -1)
        shown[skies[other]] = 0
        others.append((neighbour, shown))
    pixels = images[view].pixels
    guessed = ~measured[view] & ~skies[view] & ~coloured_like_sky(pixels)
    return pull_forward(inverse, guessed, images[view], others)


def _neighbours(
    images: Sequence[CalibratedImage], registration: Registration, view: int, most: int
) -> dict[int, Neighbour]:
    """The most useful other views for measuring the depth of `view`, by their number."""
    others = registration.neighbours_of(view)[:most]
    return {
        other: Neighbour(images[other], registration.relative(view, other))
        for other in others
    }


def inverse_depth_range(
    depths: Float[np.ndarray, "point"], several: int = SEVERAL
) -> tuple[float, float]:
    """Least and greatest inverse depth to search, from the `depths` of triangulated points.

    The outer 2 % may be wrong; beyond the rest there is room for what has no features, mostly in
    front of it. But `several` points are not wrong together: something near has few features.
    """
    inverse = np.sort(1 / depths)
    least, greatest = np.percentile(inverse, [2, 98])
    room = 0.25 * (greatest - least)
    nearest = min(inverse[-min(several, len(inverse))], NEAREST * greatest)
    return (
        max(least - room - 0.1 * least, 0.35 * least),
        max(greatest + room + 0.15 * greatest, 1.15 * nearest),
    )


def sweep_depth(
    reference: CalibratedImage,
    neighbours: Sequence[Neighbour],
    inverse_range: tuple[float, float],
    planes: int,
) -> RawDepth:
    """Unchecked depth of `reference` by all `neighbours`, with at most `planes` hypotheses."""
    inverse_depths = plane_inverse_depths(reference, neighbours, inverse_range, planes)
    cost = matching_cost(reference, neighbours, inverse_depths)
    position = best_plane(aggregate(cost, reference.grey))
    first, step = float(inverse_depths[0]), float(inverse_depths[1] - inverse_depths[0])
    return RawDepth((first + position * step).astype(np.float32), first, step)


def _measured(
    image: CalibratedImage,
    around: dict[int, Neighbour],
    view: int,
    raw: dict[int, RawDepth],
) -> Bool[np.ndarray, "height width"]:
    """Pixels whose depth at least one neighbour confirms."""
    agrees = [
        confirmed(raw[view].inverse, image, neighbour, raw[other])
        for other, neighbour in around.items()
    ]
    return without_speckles(np.any(agrees, axis=0), raw[view])
