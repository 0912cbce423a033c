"""Answers without a network, on a red disc before grey."""

import numpy as np
import pytest
from edit3r_select.asking import selected
from edit3r_select.cues import Appearance, Asked
from edit3r_select.grabcut import GrabCut

SIDE = 200
ROWS, COLUMNS = np.indices((SIDE, SIDE))
DISC = np.hypot(ROWS - 100, COLUMNS - 70) < 40
OTHER = np.hypot(ROWS - 100, COLUMNS - 160) < 20


@pytest.fixture
def photo():
    noise = np.random.default_rng(0).normal(0, 6, (SIDE, SIDE, 3))
    rgb = np.full((SIDE, SIDE, 3), 120.0)
    rgb[DISC] = (200, 50, 50)
    rgb[OTHER] = (50, 80, 200)
    return Appearance((rgb + noise).clip(0, 255).astype(np.uint8))


def iou(one, other):
    return (one & other).sum() / (one | other).sum()


def answered(photo, asked):
    return selected(photo, asked, GrabCut(photo).ask, by="grabcut").best.mask


def test_a_click_finds_what_has_its_colours(photo):
    assert iou(answered(photo, Asked(clicks=(((0.35, 0.5), True),))), DISC) > 0.9


def test_a_box_and_a_stroke_find_what_they_mark(photo):
    assert iou(answered(photo, Asked(box=(0.12, 0.27, 0.46, 0.46))), DISC) > 0.9
    stroke = tuple((x / 100, 0.5) for x in range(22, 50, 3))
    assert iou(answered(photo, Asked(stroke=stroke)), DISC) > 0.9


def test_a_second_click_adds_and_takes_away(photo):
    both = DISC | OTHER
    logits = np.where(both, 4.0, -4.0).astype(np.float32)
    away = Asked((((0.35, 0.5), True), ((0.8, 0.5), False)), before=both)
    less = selected(photo, away, GrabCut(photo).ask, logits, by="grabcut").best.mask
    assert iou(less, DISC) > 0.85 and not less[100, 160]
    logits = np.where(DISC, 4.0, -4.0).astype(np.float32)
    add = Asked((((0.35, 0.5), True), ((0.8, 0.5), True)), before=DISC)
    more = selected(photo, add, GrabCut(photo).ask, logits, by="grabcut").best.mask
    assert more[100, 160] and iou(more & DISC, DISC) > 0.9


def test_equal_questions_have_equal_answers(photo):
    clicks = [((0.35, 0.5), True)]
    first, second = (GrabCut(photo).ask(clicks)[0] for _ in range(2))
    assert (first == second).all()
