"""What a person marks is obeyed, in its photo and in every photo that sees the marked point."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry, Marks, Segmenter
from edit3r.kit.geometry.cameras import pixel_grid, project, unproject

SAME_SURFACE = 0.04
"""Relative difference in depth within which two views show one surface."""
DOT = 0.006  # radius of what a mark is worth where nothing follows it [longer sides]

Mask = Float[Tensor, "height width"]
Place = tuple[float, float]


@dataclass(frozen=True)
class Point:
    """A place on a photo that is said to lie on the object, or not to."""

    place: Place  # x and y in [0, 1]
    wanted: bool


def points_of(marks: Marks) -> list[Point]:
    """What clicks say; a stroke may stray from the object, and is obeyed as a whole."""
    said = [Point(place, True) for place in marks.positive]
    return said + [Point(place, False) for place in marks.negative]


def seen_elsewhere(
    points: Sequence[Point],
    geometry: Geometry,
    intrinsics: Float[Tensor, "1 view 3 3"],
    pair: tuple[int, int],
) -> Iterator[Point]:
    """Those of the points on the first view of the pair that the second one shows too.

    A point counts whose depth was measured, and where the second view shows the same depth.
    """
    source, view = pair
    if not geometry.registered[0, list(pair)].all():
        return
    depths = geometry.depths[0]
    height, width = depths.shape[-2:]
    grid = pixel_grid((height, width), like=depths)
    for point in points:
        row, column = _pixel(point.place, (height, width))
        if geometry.confidence[0, source, row, column] < 0.5:
            continue
        world = unproject(
            depths[source], intrinsics[0, source], geometry.c2w[0, source]
        )[row, column]
        aside = grid.new_tensor(point.place) - grid[row, column]
        there, z = project(world[None], intrinsics[0, view], geometry.c2w[0, view])
        x, y = (there[0] + aside).tolist()
        if z[0] <= 0 or not (0 <= x < 1 and 0 <= y < 1):
            continue
        shown = depths[view][_pixel((x, y), (height, width))]
        if abs(float(z[0] / shown.clamp(min=1e-9)) - 1) < SAME_SURFACE:
            yield replace(point, place=(x, y))


def obeyed(
    image: Float[Tensor, "3 height width"],
    mask: Mask,
    points: Sequence[Point],
    segmenter: Segmenter,
) -> Mask:
    """The mask with what each point lies on added or taken away, where it was not as said.

    What does not hang together with the point stays as it is. Where the segmenter follows a point
    by nothing, the point itself is obeyed.
    """
    for number, point in enumerate(points):
        if not _is_obeyed(mask, point):
            asked = _correction(mask, points[: number + 1])
            found = segmenter.segment_marks(image, asked).soft_mask
            mask = joined_change(mask, found.to(mask), point.place)
    for point in points:
        mask = _dotted(mask, point)
    return mask


def joined_change(before: Mask, after: Mask, place: Place) -> Mask:
    """`after` where its change from `before` hangs together with a place, else `before`."""
    changed = ((before > 0.5) != (after > 0.5)).numpy(force=True)
    labels = cv2.connectedComponents(changed.astype(np.uint8), connectivity=4)[1]
    label = labels[_pixel(place, changed.shape)]
    if not label:
        return before
    here = (labels == label).astype(np.uint8)
    # Its soft edge comes along, that of other changes does not.
    reach = 2 * max(2, round(DOT * max(here.shape))) + 1
    near = cv2.dilate(here, np.ones((reach, reach), np.uint8))
    others = changed & (here == 0)
    taken = torch.from_numpy((near > 0) & ~others).to(before.device)
    return torch.where(taken, after, before)


def _correction(mask: Mask, points: Sequence[Point]) -> Marks:
    """What a segmenter is asked so that the last point is obeyed."""
    last = points[-1]
    inside = (last.place,) if last.wanted else ()
    outside = () if last.wanted else (last.place,)
    return Marks(positive=inside, negative=outside, prior=mask)


def _is_obeyed(mask: Mask, point: Point) -> bool:
    return bool(mask[_pixel(point.place, mask.shape)] > 0.5) == point.wanted


def _dotted(mask: Mask, point: Point) -> Mask:
    """The mask with a dot at a point that is not obeyed."""
    if _is_obeyed(mask, point):
        return mask
    height, width = mask.shape
    radius = max(1.5, DOT * max(height, width))
    rows, columns = torch.meshgrid(
        torch.arange(height, device=mask.device) + 0.5,
        torch.arange(width, device=mask.device) + 0.5,
        indexing="ij",
    )
    x, y = point.place
    away = (rows - y * height).hypot(columns - x * width)
    return torch.where(away <= radius, float(point.wanted), mask)


def _pixel(place: Place, shape: Sequence[int]) -> tuple[int, int]:
    """Row and column of a place."""
    (x, y), (height, width) = place, shape
    return min(int(y * height), height - 1), min(int(x * width), width - 1)
