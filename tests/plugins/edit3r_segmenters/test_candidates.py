"""The choice among readings of clicks where no network answers them."""

import numpy as np
import pytest
import torch
from edit3r_segmenters.candidates import Candidate, by_size

import edit3r
from edit3r.contract.interfaces import Marks

CENTRE = (0.5, 0.5)
SIDE = 64


@pytest.fixture(scope="module")
def segmenter():
    return edit3r.build("segmenter", "classical", learned=False)


@pytest.fixture(scope="module")
def image() -> torch.Tensor:
    """A disc with a core of another colour."""
    rows, columns = torch.meshgrid(
        torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="ij"
    )
    away = (rows - SIDE / 2).hypot(columns - SIDE / 2)
    disc, core = (away < 12).float(), (away < 6).float()
    return torch.stack((0.2 + 0.6 * disc, 0.2 + 0.5 * core, torch.full_like(disc, 0.3)))


def area(found) -> float:
    return float((found.soft_mask > 0.5).sum())


def test_a_step_larger_is_larger_and_a_step_smaller_is_smaller(segmenter, image):
    def answered(larger):
        marks = Marks(positive=(CENTRE,), larger=larger)
        return area(segmenter.segment_marks(image, marks))

    areas = [answered(steps) for steps in (-9, 0, 9)]
    assert areas == sorted(areas) and areas[0] < 0.6 * areas[2]
    assert answered(1) >= answered(0) >= answered(-1)


def test_the_answer_agrees_with_all_clicks(segmenter, image):
    marks = Marks(positive=(CENTRE, (0.62, 0.5)), negative=((0.9, 0.9), (0.5, 0.75)))
    mask = segmenter.segment_marks(image, marks).soft_mask > 0.5
    places = [
        (int(y * SIDE), int(x * SIDE)) for x, y in marks.positive + marks.negative
    ]
    assert [bool(mask[place]) for place in places] == [True, True, False, False]


def test_a_click_on_what_is_wrong_takes_the_part_away_and_not_a_dot(segmenter, image):
    grown = torch.zeros(SIDE, SIDE)
    grown[16:48, 16:60] = 1
    marks = Marks(negative=((0.86, 0.5),), prior=grown)
    left = segmenter.segment_marks(image, marks).soft_mask > 0.5
    assert (grown.bool() & ~left).sum() > 100
    assert left[SIDE // 2, SIDE // 2]


def test_candidates_that_look_the_same_are_one_step():
    def square(side, score):
        mask = np.zeros((32, 32), bool)
        mask[:side, :side] = True
        return Candidate(mask, score)

    best = square(16, 1.0)
    ordered, place = by_size([best, square(17, 0.9), square(24, 0.5), square(8, 0.4)])
    assert [int(one.mask.sum()) for one in ordered] == [64, 256, 576]
    assert ordered[place] is best
    ordered, _ = by_size([best, square(24, 0.01)])
    assert ordered == [best]


def test_the_most_likely_reading_is_the_answer_where_a_part_scores_as_much(
    segmenter, image, monkeypatch
):
    found = [Candidate(disc_of(20), 1.0), Candidate(disc_of(8), 1.0)]
    monkeypatch.setattr(segmenter, "_found", lambda *_: found)
    marks = Marks(positive=(CENTRE,))
    first, second = map(area, segmenter.readings(image, marks))
    assert first == area(segmenter.segment_marks(image, marks)) > second


def disc_of(radius):
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    return np.hypot(columns - SIDE / 2, rows - SIDE / 2) < radius
