"""What a person marks is obeyed in every photo that sees the marked point."""

from dataclasses import replace

import pytest
import torch
from edit3r_select.by_segmenter import select_masks
from edit3r_select.obeying import (
    Point,
    joined_change,
    obeyed,
    seen_elsewhere,
)
from edit3r_select.photos import Photos

from edit3r.contract.interfaces import Geometry, MaskLogits, Segmenter, Selection
from edit3r_testing.scenes import photograph

SCENE = photograph(3, (48, 64))
VIEWS = SCENE.views
FIRST, SECOND = SCENE.objects[0, 0] > 0.5, SCENE.objects[1, 0] > 0.5  # [view, h, w]
GEOMETRY = Geometry(
    SCENE.cameras.c2w,
    SCENE.depths,
    torch.ones_like(SCENE.depths),
    torch.ones(1, 3, dtype=torch.bool),
)
PHOTOS = Photos(VIEWS.images[0], None, GEOMETRY, VIEWS.intrinsics)


def middle(mask):
    """x and y of the middle of a bool mask."""
    rows, columns = mask.nonzero(as_tuple=True)
    height, width = mask.shape
    return float(columns.double().mean() + 0.5) / width, float(
        rows.double().mean() + 0.5
    ) / height


class Balls(Segmenter):
    """Takes both balls for one thing, and corrects by whole balls, or by nothing."""

    def __init__(self, follows=True):
        self.follows = follows

    def masks(self, image, clicks, box=None, before=None):
        view = [torch.equal(image, one) for one in VIEWS.images[0]].index(True)
        mask = FIRST[view] | SECOND[view] if before is None else before > 0
        for ball in (FIRST[view], SECOND[view]) if self.follows else ():
            for (x, y), wanted in clicks if before is not None else ():
                if ball[int(y * 48), int(x * 64)]:
                    mask = mask | ball if wanted else mask & ~ball
        return MaskLogits(mask[None] * 8.0 - 4)


def test_a_point_is_seen_where_the_same_surface_is_shown_and_nowhere_else():
    on_first = Point(middle(FIRST[0]), True)
    (there,) = seen_elsewhere([on_first], PHOTOS, 0, 1)
    x, y = there.place
    assert FIRST[1][int(y * 48), int(x * 64)] and there.wanted
    # The exact place: it comes back to where it was.
    (back,) = seen_elsewhere([there], PHOTOS, 1, 0)
    assert back.place == pytest.approx(on_first.place, abs=0.02)
    hidden = GEOMETRY.depths.clone()
    hidden[0, 1] *= 0.5  # something stands before all of it
    behind = Geometry(GEOMETRY.c2w, hidden, GEOMETRY.confidence, GEOMETRY.registered)
    assert not list(seen_elsewhere([on_first], replace(PHOTOS, geometry=behind), 0, 1))


@pytest.mark.parametrize("follows", [True, False])
def test_marks_are_obeyed_in_all_photos_that_see_them(follows):
    wanted, unwanted = middle(FIRST[0]), middle(SECOND[0])
    marks = Selection(positive=((0, *wanted),), negative=((0, *unwanted),))
    selected = select_masks(
        VIEWS.images[0], marks, Balls(follows), GEOMETRY, VIEWS.intrinsics
    )
    for view in range(3):
        for place, inside in ((wanted, True), (unwanted, False)):
            points = [Point(place, inside)]
            if view:
                points = seen_elsewhere(points, PHOTOS, 0, view)
            for point in points:
                x, y = point.place
                value = selected.masks[view, 0, int(y * 48), int(x * 64)]
                assert bool(value > 0.5) == inside
        mask = selected.masks[view, 0] > 0.5
        if follows:  # with the part that the mark lies on
            assert not (mask & SECOND[view]).any()
        assert (mask & FIRST[view]).sum() > 0.9 * FIRST[view].sum()


def test_a_correction_changes_nothing_that_does_not_hang_together_with_it():
    before = torch.zeros(40, 40)
    before[5:15, 5:15] = 1
    after = torch.zeros(40, 40)
    after[25:35, 25:35] = 1  # what was there is gone, and something far away came
    changed = joined_change(before, after, Point((0.75, 0.75), True))
    assert (changed[5:15, 5:15] == 1).all() and (changed[25:35, 25:35] == 1).all()
    assert changed.sum() == 200
    assert torch.equal(joined_change(before, after, Point((0.9, 0.1), True)), before)


def test_what_is_obeyed_already_stays_to_the_bit():
    mask = torch.rand(48, 64)
    mask[10, 20], mask[30, 40] = 0.9, 0.1
    points = [Point((20.5 / 64, 10.5 / 48), True), Point((40.5 / 64, 30.5 / 48), False)]
    assert torch.equal(obeyed(VIEWS.images[0, 0], mask, points, Balls()), mask)
