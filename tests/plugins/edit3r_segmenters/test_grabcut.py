"""`grabcut` cuts things out by their colours, and obeys every click."""

import sys
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SUBJECT, SURE
from edit3r.loading.registry import build

# pytest in importlib mode finds no neighbours
sys.path.insert(0, str(Path(__file__).parent))

from segmenter_scenes import backdrop, ellipse, iou, tensor, with_object

SEGMENTER = build("segmenter", "grabcut", learned=False)
HEIGHT, WIDTH = 120, 160
LARGE = ellipse(HEIGHT, WIDTH, (70, 60), (30, 24))
SMALL = ellipse(HEIGHT, WIDTH, (132, 30), (9, 7))
PICTURE = tensor(
    with_object(with_object(backdrop(), LARGE), SMALL, (0.2, 0.25, 0.8), seed=4)
)


def overlaps(answer, truth):
    return [iou(one > 0, truth) for one in answer.logits.float()]


@pytest.mark.parametrize("mask", [LARGE, SMALL])
def test_one_of_its_masks_is_the_thing_under_a_click(mask):
    rows, columns = np.nonzero(mask)
    click = ((columns.mean() + 0.5) / WIDTH, (rows.mean() + 0.5) / HEIGHT)
    assert max(overlaps(SEGMENTER.masks(PICTURE, [(click, True)]), mask)) > 0.85


@pytest.mark.parametrize("mask", [LARGE, SMALL])
def test_a_box_gives_the_object_in_it(mask):
    rows, columns = np.nonzero(mask)
    left, top = columns.min() - 3, rows.min() - 3
    size = (np.ptp(columns) + 7) / WIDTH, (np.ptp(rows) + 7) / HEIGHT
    answer = SEGMENTER.masks(PICTURE, (), (left / WIDTH, top / HEIGHT, *size))
    assert overlaps(answer, mask)[0] > 0.85


def test_every_cut_obeys_every_click():
    inside, outside = (70 / WIDTH, 60 / HEIGHT), (75 / WIDTH, 62 / HEIGHT)
    for before in (None, torch.from_numpy(8 * np.float32(LARGE) - 4)):
        clicks = [(inside, True), (outside, False)]
        for one in SEGMENTER.masks(PICTURE, clicks, None, before).logits[:3]:
            assert one[60, 70] > 0 > one[62, 75]


def test_a_click_corrects_the_answer_before():
    """What was there stays, without what has the colours of the place beside it."""
    second = ellipse(HEIGHT, WIDTH, (115, 60), (18, 14)) & ~LARGE
    two = tensor(with_object(with_object(backdrop(), LARGE), second, (0.9, 0.8, 0.1)))
    before = torch.from_numpy(8 * np.float32(LARGE | second) - 4)
    clicks = [((60 / WIDTH, 0.5), True), ((117 / WIDTH, 0.5), False)]
    answer = SEGMENTER.masks(two, clicks, None, before)
    assert max(overlaps(answer, LARGE)) > 0.9


def test_it_cannot_tell_how_good_its_masks_are():
    assert SEGMENTER.masks(PICTURE, [((0.5, 0.5), True)]).quality is None


@pytest.mark.parametrize("height, width", [(1, 1), (1, 9), (5, 3), (17, 200)])
def test_pictures_of_any_size(height, width):
    image = torch.rand(3, height, width, generator=torch.Generator().manual_seed(0))
    box = (0.2, 0.2, 0.5, 0.5)
    for asked in (([((0.5, 0.5), True)],), ((), box)):
        assert SEGMENTER.masks(image, *asked).logits.shape[1:] == (height, width)


def test_words_for_things_are_not_known():
    assert SEGMENTER.words(PICTURE, "the ball") is None


def test_words_for_stuff_need_no_weights():
    scene = np.full((HEIGHT, WIDTH, 3), (0.35, 0.6, 0.95), np.float32)
    grain = np.random.default_rng(0).normal(0, 0.05, (60, WIDTH, 1))
    scene[60:] = (np.float32((0.3, 0.25, 0.1)) + grain).clip(0, 1)
    above = np.arange(HEIGHT)[:, None].repeat(WIDTH, 1) < 60
    picture = tensor(scene)
    assert iou(SEGMENTER.words(picture, "the sky")[0].soft_mask, above) > 0.95
    for name in ("the ground", "the road"):
        assert iou(SEGMENTER.words(picture, name)[0].soft_mask, ~above) > 0.9
    assert bool((SEGMENTER.words(picture, "everything")[0].soft_mask == 1).all())


def test_without_weights_the_subject_is_cut_out_of_the_middle_and_unsure():
    (subject,) = SEGMENTER.words(PICTURE, SUBJECT)
    assert iou(subject.soft_mask, LARGE | SMALL) > 0.8
    assert subject.confidence < SURE


class Network:
    """Stands in for the network of salience: the small thing stands out."""

    def setInput(self, pixels):
        self.shape = pixels.shape[2:]

    def getUnconnectedOutLayersNames(self):
        return ("out",)

    def forward(self, name):
        return cv2.resize(np.float32(SMALL), self.shape[::-1])[None, None]


@pytest.fixture
def u2netp(tmp_path, monkeypatch):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    (tmp_path / "u2netp").mkdir()
    return tmp_path / "u2netp" / "u2netp.onnx"


def test_with_weights_the_subject_is_what_the_network_sees_and_it_is_forgotten(
    u2netp, monkeypatch
):
    read = []

    def counted(path):
        network = Network()
        read.append(weakref.ref(network))
        return network

    u2netp.touch()
    monkeypatch.setattr(cv2.dnn, "readNetFromONNX", counted)
    (subject,) = build("segmenter", "grabcut").words(PICTURE, SUBJECT)
    assert iou(subject.soft_mask, SMALL) > 0.8
    assert len(read) == 1 and read[0]() is None


@pytest.mark.parametrize("content", [b"", b"not a network", bytes(range(256)) * 40])
def test_a_damaged_network_of_salience_is_one_sentence(content, u2netp):
    u2netp.write_bytes(content)
    with pytest.raises(InputError, match=r"u2netp\.onnx: is no whole .* get u2netp"):
        build("segmenter", "grabcut").words(PICTURE, SUBJECT)
