"""Cues by closed forms on a disc."""

import numpy as np
import pytest
from edit3r_select.cues import CUES, OF_ANY_SIZE, Asked, Pool, pixel, table

SIDE = 120
ROWS, COLUMNS = np.indices((SIDE, SIDE))
DISC = np.hypot(ROWS - 60, COLUMNS - 60) < 30
LEFT = DISC & (COLUMNS < 60)  # a part of it
ALL = np.ones((SIDE, SIDE), bool)
TWO = LEFT | (np.hypot(ROWS - 10, COLUMNS - 110) < 5)  # with a crumb far away
CENTRE = ((60.5 / SIDE, 60.5 / SIDE), True)


def as_logits(*masks):
    return np.where(np.stack(masks), 4.0, -4.0).astype(np.float32)


def pool(asked=None, masks=(DISC, LEFT, ALL, TWO)):
    quality = np.linspace(0.9, 0.6, len(masks))
    asked = Asked(clicks=(CENTRE,)) if asked is None else asked
    return Pool(asked, as_logits(*masks), quality)


def test_every_cue_is_one_number_a_mask_and_says_what_it_means():
    values = table(pool())
    assert values.shape == (4, len(CUES)) and np.isfinite(values).all()
    assert all(cue.__doc__ for cue in CUES.values())


def test_what_fills_the_photo_touches_its_whole_border():
    assert CUES["border"](pool()).tolist()[:3] == [0, 0, 1]
    halves = (COLUMNS < 60, COLUMNS >= 60, ROWS < 60, ROWS >= 60)
    assert CUES["border"](pool(masks=halves)).tolist() == [0.5] * 4


def test_sizes_and_overlaps_are_shares():
    some = pool()
    assert some.areas[0] == DISC.mean()
    size = CUES["square_of_log_area"](some)
    assert size[2] == pytest.approx(0, abs=1e-6) and size[1] > size[0] > size[2]
    assert some.overlaps[0, 0] == 1
    assert some.overlaps[0, 1] == pytest.approx(LEFT.sum() / DISC.sum())


def test_crumbs_are_seen():
    pieces = CUES["largest_piece"](pool())
    assert pieces[0] == 1 > pieces[3] > 0.9


def test_a_click_in_the_middle_is_the_most_central():
    assert CUES["centrality"](pool())[0] > 0.95
    rim = Asked(clicks=(((88.5 / SIDE, 60.5 / SIDE), True),))
    assert CUES["centrality"](pool(rim))[0] < 0.2


def test_marks_are_obeyed_inside_and_outside():
    left, right = (40.5 / SIDE, 0.5), (80.5 / SIDE, 0.5)
    asked = Asked(((left, True), (right, False)), before=as_logits(DISC)[0])
    assert CUES["obeyed"](pool(asked)).tolist() == [0.5, 1, 0.5, 1]
    assert asked.kind == "more"
    # taking the right half away changes it around the click, leaving all as it is changes nothing
    middle = CUES["middle"](pool(asked))
    assert middle[0] == 0 and middle[1] > 0.5


def test_a_click_on_the_last_edge_is_on_the_last_pixel():
    assert pixel((1.0, 1.0), (40, 60)) == (39, 59)
    assert pixel((0.0, 0.5), (40, 60)) == (20, 0)


def test_of_further_answers_those_that_agree_count():
    asked = Asked((CENTRE, CENTRE), before=as_logits(DISC)[0])
    masks = (DISC, DISC, LEFT, np.zeros_like(DISC))
    assert CUES["agreement"](pool(asked, masks)) == pytest.approx(
        [(1 + 0.5) / 3, (1 + 0.5) / 3, (0.5 + 0.5) / 3, 0], abs=0.02
    )
    assert not CUES["agreement"](pool(masks=masks)).any()


def test_an_empty_mask_shows_its_size_and_quality_alone():
    empty = table(pool(masks=(DISC, np.zeros_like(DISC))))[1]
    assert {name for name, value in zip(CUES, empty) if value} <= {*OF_ANY_SIZE}


def test_what_other_photos_do_not_tell_of_counts_for_nothing():
    told = Asked((CENTRE,), expected=LEFT, known=COLUMNS < 60)
    whole, part, photo, _ = CUES["expected"](pool(told))
    assert whole == part == 1 > photo
    everywhere = Asked((CENTRE,), expected=LEFT, known=ALL)
    assert CUES["expected"](pool(everywhere))[0] == LEFT.sum() / DISC.sum()
