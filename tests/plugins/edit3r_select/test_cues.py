"""Cues by closed forms on a disc before a flat background."""

import numpy as np
import pytest
from edit3r_select.cues import CUES, Appearance, Asked, Pool, table

SIDE = 120
ROWS, COLUMNS = np.indices((SIDE, SIDE))
DISC = np.hypot(ROWS - 60, COLUMNS - 60) < 30
LEFT = DISC & (COLUMNS < 60)  # a part of it
ALL = np.ones((SIDE, SIDE), bool)
TWO = LEFT | (np.hypot(ROWS - 10, COLUMNS - 110) < 5)  # with a crumb far away
CENTRE = ((60.5 / SIDE, 60.5 / SIDE), True)


@pytest.fixture
def photo():
    rgb = np.full((SIDE, SIDE, 3), 40, np.uint8)
    rgb[DISC] = (200, 60, 60)
    return Appearance(rgb)


def pool(photo, asked=None, masks=(DISC, LEFT, ALL, TWO)):
    logits = np.where(np.stack(masks), 4.0, -4.0).astype(np.float32)
    quality = np.linspace(0.9, 0.6, len(masks))
    asked = Asked(clicks=(CENTRE,)) if asked is None else asked
    return Pool(photo, asked, logits, quality, np.arange(len(masks)) == 0)


def test_every_cue_is_one_number_a_mask_and_says_what_it_means(photo):
    values = table(pool(photo))
    assert values.shape == (4, len(CUES)) and np.isfinite(values).all()
    assert all(cue.__doc__ for cue in CUES.values())


def test_the_outline_of_a_thing_has_edges_and_contrast_and_that_of_a_part_less(photo):
    edge, contrast = (CUES[name](pool(photo)) for name in ("edge", "contrast"))
    assert edge[0] == max(edge) and contrast[0] == max(contrast) > 1


def test_what_fills_the_photo_touches_its_whole_border(photo):
    assert CUES["border"](pool(photo)).tolist()[:3] == [0, 0, 1]


def test_sizes_compare_the_masks_with_each_other(photo):
    some = pool(photo)
    assert some.areas[0] == DISC.mean()
    assert CUES["larger"](some)[2] == 0 and CUES["smaller"](some)[2] == 1
    assert CUES["relative_area"](some)[2] == max(CUES["relative_area"](some))


def test_crumbs_and_gaps_are_seen(photo):
    pieces, solid = (CUES[name](pool(photo)) for name in ("largest_piece", "solidity"))
    assert pieces[0] == 1 > pieces[3] > 0.9
    assert solid[3] < 0.6 < solid[0]


def test_a_click_in_the_middle_is_the_most_central(photo):
    assert CUES["centrality"](pool(photo))[0] > 0.95
    rim = Asked(clicks=(((88.5 / SIDE, 60.5 / SIDE), True),))
    assert CUES["centrality"](pool(photo, rim))[0] < 0.2


def test_marks_are_obeyed_inside_and_outside(photo):
    left, right = (40.5 / SIDE, 0.5), (80.5 / SIDE, 0.5)
    asked = Asked(clicks=((left, True), (right, False)), before=DISC)
    assert CUES["obeyed"](pool(photo, asked)).tolist() == [0.5, 1, 0.5, 1]
    assert asked.kind == "more"
    assert CUES["kept"](pool(photo, asked))[0] == 1
    # taking the right half away changes it around the click, leaving all as it is changes nothing
    middle = CUES["middle"](pool(photo, asked))
    assert middle[0] == 0 and middle[1] > 0.5


def test_a_box_is_filled_by_what_it_was_drawn_around(photo):
    around = Asked(box=(30 / SIDE, 30 / SIDE, 60 / SIDE, 60 / SIDE))
    filled = CUES["fills_box"](pool(photo, around))
    assert filled[0] == max(filled) > 0.9 and around.kind == "box"
    assert filled[2] == pytest.approx(0.25, abs=0.01)


def test_an_empty_mask_shows_its_size_and_quality_alone(photo):
    empty = table(pool(photo, masks=(DISC, np.zeros_like(DISC))))[1]
    names = list(CUES)
    told = {name for name, value in zip(names, empty) if value}
    assert told <= {"quality", "log_area", "square_of_log_area", "obeyed"}
