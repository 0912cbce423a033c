"""The choice among readings of clicks, with a network that answers with discs around a click."""

import numpy as np
import pytest
import torch
from edit3r_segmenters.candidates import (
    Candidate,
    by_size,
    completed,
)

import edit3r
from edit3r.contract.interfaces import Marks

CENTRE = (0.5, 0.5)
RADII = (6.0, 12.0, 20.0)
SIDE = 64


class Discs:
    """A network whose masks are discs around the first click, and a bar at one that is wrong."""

    def ask(self, image, clicks, box=None, before=None):
        rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
        (x, y), _ = clicks[0]
        away = np.hypot(columns - x * SIDE, rows - y * SIDE)
        return np.stack([radius - away for radius in RADII]), np.array([0.9, 0.8, 0.7])


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
    disc, core = (away < RADII[1]).float(), (away < RADII[0]).float()
    return torch.stack((0.2 + 0.6 * disc, 0.2 + 0.5 * core, torch.full_like(disc, 0.3)))


def area(found) -> float:
    return float((found.soft_mask > 0.5).sum())


def test_a_step_larger_is_larger_and_a_step_smaller_is_smaller(segmenter, image):
    def answered(larger):
        marks = Marks(positive=(CENTRE,), larger=larger)
        return area(segmenter.answer(image, marks, Discs()))

    areas = [answered(steps) for steps in (-9, 0, 9)]
    assert areas == sorted(areas) and areas[0] < 0.6 * areas[2]
    assert answered(1) >= answered(0) >= answered(-1)


@pytest.mark.parametrize("network", [None, Discs()])
def test_the_answer_agrees_with_all_clicks(segmenter, image, network):
    marks = Marks(positive=(CENTRE, (0.62, 0.5)), negative=((0.9, 0.9), (0.5, 0.75)))
    mask = segmenter.answer(image, marks, network).soft_mask > 0.5
    places = [
        (int(y * SIDE), int(x * SIDE)) for x, y in marks.positive + marks.negative
    ]
    assert [bool(mask[place]) for place in places] == [True, True, False, False]


def test_a_click_on_what_is_wrong_takes_the_part_away_and_not_a_dot(segmenter, image):
    grown = torch.zeros(SIDE, SIDE)
    grown[16:48, 16:60] = 1
    marks = Marks(negative=((0.86, 0.5),), prior=grown)
    left = segmenter.answer(image, marks, Discs()).soft_mask > 0.5
    assert (grown.bool() & ~left).sum() > 100
    assert left[SIDE // 2, SIDE // 2]


class Aside:
    """A network that sees the disc of the image wherever on it one clicks, and a crumb there."""

    def ask(self, image, clicks, box=None, before=None):
        rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
        (x, y), _ = clicks[0]
        to_middle = np.hypot(columns - SIDE / 2, rows - SIDE / 2)
        to_click = np.hypot(columns - x * SIDE, rows - y * SIDE)
        disc, crumb = RADII[1] - to_middle, 3 - to_click
        return np.stack([disc, disc + 0.5, crumb]), np.array([0.9, 0.8, 0.7])


@pytest.mark.parametrize("aside", [0.0, 0.05, 0.1, 0.13])
def test_a_click_aside_of_the_middle_means_the_same_thing(segmenter, image, aside):
    found = segmenter.answer(image, Marks(positive=((0.5 + aside, 0.5),)), Aside())
    disc = np.pi * RADII[1] ** 2
    assert 0.85 * disc < area(found) < 1.15 * disc


def test_a_network_is_told_the_answer_that_a_click_corrects(segmenter, image):
    told = []

    class Told(Discs):
        def ask(self, image, clicks, box=None, before=None):
            if before is not None:
                told.append((len(clicks), before > 0))
            return super().ask(image, clicks, box)

    segmenter._memory.clear()
    once = segmenter.answer(image, Marks(positive=(CENTRE,)), Told())
    assert not told
    segmenter.answer(image, Marks(positive=(CENTRE, (0.85, 0.5))), Told())
    ((clicks, before),) = told
    assert clicks == 2
    assert before.sum() == pytest.approx(area(once), rel=0.1)


class Islands:
    """A network whose masks are the disc of the image and a square apart from it."""

    def ask(self, image, clicks, box=None, before=None):
        rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
        disc = RADII[1] - np.hypot(columns - SIDE / 2, rows - SIDE / 2)
        disc[2:9, 2:9] = 1
        return np.stack([disc, disc, disc]), np.array([0.9, 0.8, 0.7])


def test_what_lies_apart_from_one_click_is_left_out_and_a_second_click_adds_it(
    segmenter, image
):
    def island(*places):
        found = segmenter.answer(image, Marks(positive=places), Islands())
        return float((found.soft_mask[2:9, 2:9] > 0.5).float().mean())

    assert island(CENTRE) == 0
    assert island(CENTRE, (0.085, 0.085)) > 0.8


class Crumbs:
    """A network whose four masks are one disc, each with a bite and a crumb of its own."""

    def ask(self, image, clicks, box=None, before=None):
        rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
        away = np.hypot(columns - SIDE / 2, rows - SIDE / 2)
        logits = np.stack([RADII[1] - away] * 4)
        for one, bite in zip(logits, (22, 28, 34, 40)):
            one[bite : bite + 5, 22:31] = -1
            one[2:8, bite : bite + 6] = 1
        return logits, np.full(4, 0.9)


def test_what_is_one_candidate_s_alone_is_outvoted_by_those_like_it(segmenter, image):
    found = segmenter.answer(image, Marks(positive=((0.55, 0.5),)), Crumbs())
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    disc = np.hypot(columns - SIDE / 2, rows - SIDE / 2) < RADII[1]
    mask = found.soft_mask.numpy() > 0.5
    assert (mask & disc).sum() / (mask | disc).sum() > 0.95
    assert not mask[:8].any()


def test_candidates_that_look_the_same_are_one_step():
    def square(side, score):
        logits = np.full((32, 32), -1.0)
        logits[:side, :side] = 1
        return Candidate(logits, score)

    best = square(16, 1.0)
    ordered, place = by_size([best, square(17, 0.9), square(24, 0.5), square(8, 0.4)])
    assert [int(one.mask.sum()) for one in ordered] == [64, 256, 576]
    assert ordered[place] is best


def test_the_most_likely_reading_is_the_answer_where_a_part_scores_as_much(
    segmenter, image, monkeypatch
):
    found = [Candidate(disc_of(20), 1.0), Candidate(disc_of(8), 1.0)]
    monkeypatch.setattr(segmenter, "_found", lambda *_: found)
    marks = Marks(positive=(CENTRE,))
    first, second = map(area, segmenter.likely(image, marks, Discs()))
    assert first == area(segmenter.answer(image, marks, Discs())) > second


class TestCompleted:
    """A thing of two halves; the photo that says where it is shows only the left half."""

    THING = np.zeros((64, 96), bool)
    THING[16:48, 16:80] = True
    KNOWN = np.zeros((64, 96), bool)
    KNOWN[:, :48] = True
    EXPECTED = THING & KNOWN

    def of(self, *answers, expected=EXPECTED, known=KNOWN):
        logits = np.stack([np.where(answer, 4.0, -4) for answer in answers])
        return completed(expected, known, lambda clicks, box: logits)

    def test_an_answer_that_agrees_is_the_whole_thing(self):
        uneven = self.THING.copy()
        uneven[16, 16:48] = False  # where it is known, the network's outline holds too
        assert np.array_equal(self.of(self.KNOWN, uneven), uneven)

    def test_a_part_that_lies_within_it_adds_what_was_hidden(self):
        part = self.THING.copy()
        part[28:] = False
        assert np.array_equal(self.of(part), self.EXPECTED | part)

    def test_what_reaches_beyond_what_is_known_not_to_be_it_is_left(self):
        wide = np.zeros_like(self.THING)
        wide[12:52, 12:80] = True
        assert np.array_equal(self.of(wide), self.EXPECTED)

    def test_what_is_hardly_confirmed_is_left(self):
        far = np.zeros_like(self.THING)
        far[20:44, 44:] = True
        assert np.array_equal(self.of(far), self.EXPECTED)

    def test_where_all_is_known_no_network_is_asked(self):
        everywhere = np.ones_like(self.KNOWN)
        found = completed(self.EXPECTED, everywhere, None)
        assert np.array_equal(found, self.EXPECTED)
        nothing = np.zeros_like(self.KNOWN)
        assert not completed(nothing, nothing, None).any()

    def test_an_answer_that_surely_agrees_ends_the_questions(self):
        asked = []

        def prompt(clicks, box):
            asked.append(box)
            return np.where(self.THING, 4.0, -4)[None]

        assert np.array_equal(completed(self.EXPECTED, self.KNOWN, prompt), self.THING)
        assert asked == [((16, 16), (48, 48))]  # all places at once, in their box


def disc_of(radius):
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    return radius - np.hypot(columns - SIDE / 2, rows - SIDE / 2)
