"""What a person marks is obeyed, in its photo and in every photo that sees the marked point."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch

from edit3r.contract.interfaces import Segmenter
from edit3r.kit.geometry.cameras import pixel_grid, project, unproject
from edit3r_select.answering import Image, answered
from edit3r_select.cues import pixel
from edit3r_select.marks import Marks
from edit3r_select.photos import SAME_SURFACE, Mask, Photos

DOT = 0.006  # radius of what a mark is worth where nothing follows it [longer sides]


@dataclass(frozen=True)
class Point:
    """A place on a photo that is said to lie on the object, or not to."""

    place: tuple[float, float]  # x and y in [0, 1]
    wanted: bool

    def pixel(self, shape: Sequence[int]) -> tuple[int, int]:
        """Its row and column."""
        return pixel(self.place, (shape[0], shape[1]))

    def is_obeyed(self, mask: Mask) -> bool:
        return bool(mask[self.pixel(mask.shape)] > 0.5) == self.wanted


def points_of(marks: Marks) -> list[Point]:
    """What clicks say; a stroke may stray from the object, and is obeyed as a whole."""
    said = [Point(place, True) for place in marks.positive]
    return said + [Point(place, False) for place in marks.negative]


def seen_elsewhere(
    points: Sequence[Point], photos: Photos, source: int, view: int
) -> Iterator[Point]:
    """Those of the points on photo `source` that photo `view` shows too: their depth was measured,
    and `view` shows the same.
    """
    geometry, lenses = photos.geometry, photos.intrinsics
    if geometry is None or lenses is None:
        return
    if not geometry.registered[0, [source, view]].all():
        return
    depths, c2w = geometry.depths[0], geometry.c2w[0]
    height, width = depths.shape[-2:]
    grid = pixel_grid((height, width), like=depths)
    for point in points:
        row, column = point.pixel((height, width))
        if not geometry.is_measured[0, source, row, column]:
            continue
        world = unproject(depths[source], lenses[0, source], c2w[source])[row, column]
        aside = grid.new_tensor(point.place) - grid[row, column]
        there, z = project(world[None], lenses[0, view], c2w[view])
        x, y = (there[0] + aside).tolist()
        if z[0] <= 0 or not (0 <= x < 1 and 0 <= y < 1):
            continue
        moved = replace(point, place=(x, y))
        shown = depths[view][moved.pixel((height, width))]
        if abs(float(z[0] / shown.clamp(min=1e-9)) - 1) < SAME_SURFACE:
            yield moved


def obeyed(
    image: Image, mask: Mask, points: Sequence[Point], segmenter: Segmenter
) -> Mask:
    """The mask with what each point lies on added or taken away, where it was not as said.

    What does not hang together with the point stays as it is. Where the segmenter follows a point
    by nothing, a dot obeys it.
    """
    for point in points:
        if not point.is_obeyed(mask):
            inside = (point.place,) if point.wanted else ()
            outside = () if point.wanted else (point.place,)
            marks = Marks(inside, outside, prior=mask)
            found = answered(segmenter, image, marks).mask
            mask = joined_change(mask, found.to(mask), point)
    for point in points:
        if not point.is_obeyed(mask):
            mask = _dotted(mask, point)
    return mask


def joined_change(before: Mask, after: Mask, point: Point) -> Mask:
    """`after` where its change from `before` hangs together with a point, else `before`."""
    changed = ((before > 0.5) != (after > 0.5)).numpy(force=True)
    labels = cv2.connectedComponents(changed.astype(np.uint8), connectivity=4)[1]
    label = labels[point.pixel(changed.shape)]
    if not label:
        return before
    here = (labels == label).astype(np.uint8)
    # Its soft edge comes along, that of other changes does not.
    reach = 2 * max(2, round(DOT * max(here.shape))) + 1
    near = cv2.dilate(here, np.ones((reach, reach), np.uint8))
    others = changed & (here == 0)
    taken = torch.from_numpy((near > 0) & ~others).to(before.device)
    return torch.where(taken, after, before)


def _dotted(mask: Mask, point: Point) -> Mask:
    """The mask with a dot at a point that is not obeyed."""
    height, width = mask.shape
    radius = max(1.5, DOT * max(height, width))
    x, y = pixel_grid((height, width), like=mask).unbind(-1)
    away = ((x - point.place[0]) * width).hypot((y - point.place[1]) * height)
    return torch.where(away <= radius, float(point.wanted), mask)
