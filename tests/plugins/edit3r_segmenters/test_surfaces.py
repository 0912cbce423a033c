"""Depth tells surfaces apart, and what stands before what is behind it."""

import cv2
import numpy as np
import pytest
import torch
from edit3r_segmenters.surfaces import Surfaces

import edit3r
from edit3r.contract.interfaces import Marks, Relief

SHAPE = (64, 96)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
BALL = np.hypot(ROWS - 30, COLUMNS - 40) < 12


def scene() -> np.ndarray:
    """Camera z of a ball at 2 before a slanted wall at 4 and more."""
    wall = 1 / (0.25 - 0.0008 * COLUMNS)
    return np.where(BALL, 2.0, wall).astype(np.float32)


@pytest.fixture
def surfaces():
    return Surfaces.of(scene(), np.ones(SHAPE, bool), SHAPE)


def overlap(one, other):
    return (one & other).sum() / (one | other).sum()


def test_a_surface_ends_where_depth_jumps(surfaces):
    parts = surfaces.at((30, 40))
    assert max(overlap(part, BALL) for part in parts) > 0.8
    assert not any(overlap(part, BALL) > 0.3 for part in surfaces.at((5, 90)))


def test_what_stands_before_others_is_told_from_what_lies_behind(surfaces):
    assert surfaces.before(BALL) > 0.9
    assert surfaces.before(~BALL) < 0.1
    flat = (ROWS < 60) & (COLUMNS > 70) & (ROWS > 8) & (COLUMNS < 88)
    assert surfaces.before(flat) == pytest.approx(0.5, abs=0.2)


def test_a_large_plane_is_found_where_the_click_is_not_on_it(surfaces):
    assert not surfaces._support((5, 90)).any()
    assert overlap(surfaces._support((30, 40)), ~BALL) > 0.8


class Two:
    """A network that is of two minds: the ball, or all that has its colour; both as it believes."""

    def ask(self, image, clicks, box=None, before=None):
        wide = np.hypot(ROWS - 30, COLUMNS - 52) < 25
        if box is not None and box[2] < 0.4:
            wide = BALL
        return np.stack([np.where(BALL, 4.0, -4.0), np.where(wide, 4.0, -4.0)]), None


@pytest.fixture
def image():
    """Ball and what is beside it look alike: colours tell the wide reading."""
    wide = np.hypot(ROWS - 30, COLUMNS - 52) < 25
    return torch.from_numpy(np.stack([0.2 + 0.6 * wide] * 3)).float()


def test_depth_chooses_the_reading_that_colours_do_not(image):
    segmenter = edit3r.build("segmenter", "classical", learned=False)
    click = {"positive": ((46 / 96, 30.5 / 64),)}
    relief = Relief(torch.from_numpy(scene()), torch.ones(SHAPE, dtype=torch.bool))
    by_colour, by_depth = (
        segmenter.answer(image, Marks(**click, relief=known), Two()).soft_mask.numpy()
        for known in (None, relief)
    )
    assert overlap(by_depth > 0.5, BALL) > 0.9 > 0.5 > overlap(by_colour > 0.5, BALL)


def test_a_stroke_asks_with_all_its_points_in_one_ranking(image):
    asked = []

    class Listening(Two):
        def ask(self, image, clicks, box=None, before=None):
            asked.append(len(clicks))
            return super().ask(image, clicks, box, before)

    segmenter = edit3r.build("segmenter", "classical", learned=False)
    line = tuple((x / 96, 30.5 / 64) for x in range(32, 48))
    found = segmenter.answer(image, Marks(stroke=line), Listening())
    assert asked[0] == 6 and asked[1:7] == [1] * 6
    held = [bool(found.soft_mask[30, x] > 0.5) for x in range(32, 48)]
    assert np.mean(held) >= 0.8


class Counting(Two):
    """The same network, that counts boxes; `agreed`: it has one answer to a click."""

    def __init__(self, agreed=False):
        self.agreed, self.boxes = agreed, []

    def ask(self, image, clicks, box=None, before=None):
        logits, quality = super().ask(image, clicks, box, before)
        if box is None:
            return (logits[:1] if self.agreed else logits), quality
        self.boxes.append(box)
        return logits, quality


@pytest.mark.parametrize("agreed, boxes", [(True, 1), (False, 2)])
def test_depth_asks_a_network_only_where_answers_differ_and_once_for_like_boxes(
    image, monkeypatch, agreed, boxes
):
    """Two surfaces of nearly one box, which is not that of any reading."""
    around = np.hypot(ROWS - 30, COLUMNS - 40) < 22
    rimless = cv2.erode(around.astype(np.uint8), np.ones((3, 3))) > 0
    monkeypatch.setattr(Surfaces, "at", lambda self, place: [around, rimless])
    network = Counting(agreed)
    relief = Relief(torch.from_numpy(scene()), torch.ones(SHAPE, dtype=torch.bool))
    marks = Marks(positive=((46 / 96, 30.5 / 64),), relief=relief)
    segmenter = edit3r.build("segmenter", "classical", learned=False)
    segmenter.answer(image, marks, network)
    assert len(network.boxes) == boxes
