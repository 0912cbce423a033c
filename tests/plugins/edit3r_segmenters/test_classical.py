import sys
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from edit3r_segmenters.candidates import Evidence, Salience, choose
from edit3r_segmenters.classical import _analyse

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SURE, Marks
from edit3r.kit.photos.images import load_views, packaged_pair
from edit3r.loading.registry import build

# pytest in importlib mode finds no neighbours
sys.path.insert(0, str(Path(__file__).parent))

from segmenter_scenes import backdrop, ellipse, iou, tensor, with_object

SEGMENTER = build("segmenter", "classical")
HEIGHT, WIDTH = 120, 160
LARGE = ellipse(HEIGHT, WIDTH, (70, 60), (30, 24))
SMALL = ellipse(HEIGHT, WIDTH, (132, 30), (9, 7))
PICTURE = tensor(
    with_object(with_object(backdrop(), LARGE), SMALL, (0.2, 0.25, 0.8), seed=4)
)


def test_the_object_in_the_middle_is_the_most_salient():
    assert iou(SEGMENTER.propose(PICTURE)[0].soft_mask, LARGE) > 0.93


def test_other_objects_are_proposed_too():
    assert (
        max(iou(proposal.soft_mask, SMALL) for proposal in SEGMENTER.propose(PICTURE))
        > 0.8
    )


def test_proposals_do_not_repeat_an_object():
    masks = [proposal.soft_mask for proposal in SEGMENTER.propose(PICTURE)]
    pairs = [(a, b) for index, a in enumerate(masks) for b in masks[:index]]
    assert pairs and all(iou(a, b.numpy()) < 0.75 for a, b in pairs)


def test_fields_agree_with_the_mask():
    proposal = SEGMENTER.propose(PICTURE)[0]
    inside = proposal.soft_mask > 0.5
    rows, columns = torch.nonzero(inside, as_tuple=True)
    assert proposal.area == pytest.approx(float(inside.float().mean()), abs=1e-6)
    x, y, width, height = proposal.box
    assert (x, y) == (columns.min(), rows.min()) and (x + width, y + height) == (
        columns.max() + 1,
        rows.max() + 1,
    )
    assert proposal.soft_mask.min() >= 0 and proposal.soft_mask.max() <= 1
    assert ((proposal.soft_mask > 0.05) & (proposal.soft_mask < 0.95)).any()


def test_a_clear_outline_scores_higher_than_a_faint_one():
    faint = tensor(with_object(backdrop(), LARGE, (0.42, 0.5, 0.37)))
    clear = SEGMENTER.segment(PICTURE, [(70 / WIDTH, 60 / HEIGHT)])
    weak = SEGMENTER.segment(faint, [(70 / WIDTH, 60 / HEIGHT)])
    assert clear.predicted_iou > 1.3 * weak.predicted_iou


def test_the_same_picture_gives_the_same_proposals():
    first, second = SEGMENTER.propose(PICTURE), SEGMENTER.propose(PICTURE)
    assert len(first) == len(second)
    assert all(
        torch.equal(a.soft_mask, b.soft_mask) and a.box == b.box
        for a, b in zip(first, second)
    )


@pytest.mark.parametrize("mask", [LARGE, SMALL])
def test_a_point_gives_the_object_under_it(mask):
    rows, columns = np.nonzero(mask)
    point = ((columns.mean() + 0.5) / WIDTH, (rows.mean() + 0.5) / HEIGHT)
    assert iou(SEGMENTER.segment(PICTURE, [point]).soft_mask, mask) > 0.8


def test_two_points_give_one_object_with_both():
    proposal = SEGMENTER.segment(
        PICTURE, [(70.5 / WIDTH, 60.5 / HEIGHT), (90 / WIDTH, 60 / HEIGHT)]
    )
    assert iou(proposal.soft_mask, LARGE) > 0.8


@pytest.mark.parametrize("mask", [LARGE, SMALL])
def test_a_box_gives_the_object_in_it(mask):
    rows, columns = np.nonzero(mask)
    box = (
        (columns.min() - 3) / WIDTH,
        (rows.min() - 3) / HEIGHT,
        (np.ptp(columns) + 7) / WIDTH,
        (np.ptp(rows) + 7) / HEIGHT,
    )
    assert iou(SEGMENTER.segment(PICTURE, box=box).soft_mask, mask) > 0.85


def test_a_point_or_a_box_is_needed():
    with pytest.raises(InputError, match="at least one point, or a box"):
        SEGMENTER.segment(PICTURE)


@pytest.mark.parametrize("height, width", [(1, 1), (1, 9), (5, 3), (17, 200)])
def test_pictures_of_any_size(height, width):
    image = torch.rand(3, height, width, generator=torch.Generator().manual_seed(0))
    for proposal in SEGMENTER.propose(image):
        assert proposal.soft_mask.shape == (height, width)
    assert SEGMENTER.segment(image, [(0.5, 0.5)]).soft_mask.shape == (height, width)
    assert SEGMENTER.segment(image, box=(0.2, 0.2, 0.5, 0.5)).soft_mask.shape == (
        height,
        width,
    )
    tracks = SEGMENTER.track(
        image.expand(2, 3, height, width), torch.ones(1, height, width)
    )
    assert tracks.logits.shape == (2, 1, height, width)


@pytest.mark.slow
def test_a_large_picture_is_answered_at_its_own_size():
    large = torch.nn.functional.interpolate(
        PICTURE[None], scale_factor=5, mode="bilinear"
    )[0]
    mask = SEGMENTER.propose(large)[0].soft_mask
    assert mask.shape == (5 * HEIGHT, 5 * WIDTH)
    assert iou(mask, np.kron(LARGE, np.ones((5, 5)))) > 0.93


def test_words_for_things_are_not_known():
    assert SEGMENTER.segment_text(PICTURE, "the ball") is None


def test_words_for_stuff_need_no_weights():
    scene = np.full((HEIGHT, WIDTH, 3), (0.35, 0.6, 0.95), np.float32)
    grain = np.random.default_rng(0).normal(0, 0.05, (60, WIDTH, 1))
    scene[60:] = (np.float32((0.3, 0.25, 0.1)) + grain).clip(0, 1)
    above = np.arange(HEIGHT)[:, None].repeat(WIDTH, 1) < 60
    picture = tensor(scene)
    assert iou(SEGMENTER.segment_text(picture, "the sky")[0].soft_mask, above) > 0.95
    for name in ("the ground", "the road"):
        assert iou(SEGMENTER.segment_text(picture, name)[0].soft_mask, ~above) > 0.9
    assert bool((SEGMENTER.segment_text(picture, "everything")[0].soft_mask == 1).all())
    (background,) = SEGMENTER.segment_text(PICTURE, "the background")
    assert iou(background.soft_mask, ~LARGE) > 0.9
    assert background.confidence < SURE  # without learned salience it may be anything


def test_a_negative_point_takes_a_part_away_and_a_positive_one_adds_it():
    two = with_object(
        with_object(backdrop(), LARGE),
        ellipse(HEIGHT, WIDTH, (115, 60), (18, 14)),
        (0.9, 0.8, 0.1),
        5,
    )
    other = ellipse(HEIGHT, WIDTH, (115, 60), (18, 14)) & ~LARGE
    first, second = (60 / WIDTH, 60 / HEIGHT), (117 / WIDTH, 60 / HEIGHT)
    both = SEGMENTER.segment_marks(tensor(two), Marks((first, second))).soft_mask
    assert iou(both, LARGE | other) > 0.85
    prior = torch.from_numpy((LARGE | other).astype(np.float32))
    less = SEGMENTER.segment_marks(
        tensor(two), Marks((first,), (second,), prior=prior)
    ).soft_mask
    assert iou(less, LARGE) > 0.85


def test_a_mask_that_is_expected_moves_to_the_outline_near_it():
    """It says of itself how little it moved."""
    expected = torch.from_numpy(
        ellipse(HEIGHT, WIDTH, (72, 60), (32, 25)).astype(np.float32)
    )
    found = SEGMENTER.segment_marks(PICTURE, Marks(prior=expected))
    assert iou(found.soft_mask, LARGE) > max(0.93, iou(expected, LARGE))
    assert 0.7 < found.predicted_iou < 1


def test_learned_salience_that_a_click_agrees_with_decides_between_part_and_whole():
    """A whole in two colours: by colours alone a click means the part under it."""
    whole = np.zeros((HEIGHT, WIDTH), dtype=bool)
    whole[30:90, 40:120] = True
    part = whole & (np.arange(WIDTH) < 80)
    scene = with_object(with_object(backdrop(), whole), part, (0.2, 0.25, 0.8), seed=4)
    analysis = _analyse(scene.astype(np.float32), 160)
    seen = cv2.resize(whole.astype(np.float32), analysis.pixels.shape[1::-1])
    everywhere = np.ones(seen.shape, dtype=bool)
    shared = (analysis.pixels, analysis.superpixels, analysis.members, analysis.measure)
    spot = (seen.shape[0] // 2, seen.shape[1] * 75 // WIDTH)
    alone, told = (
        choose(Evidence(*shared, saliences), [(spot, True)])[0].mask
        for saliences in ((), (Salience(seen, everywhere),))
    )
    assert (
        iou(torch.from_numpy(told), seen > 0.5)
        > 0.9
        > iou(torch.from_numpy(alone), seen > 0.5)
    )


@pytest.mark.slow
def test_the_packaged_motorcycle_is_what_its_picture_is_about():
    """Its red tank and seat: the largest part of it in one colour."""
    paths, _ = packaged_pair()
    images = load_views(paths, size=384).images[0]
    proposal = SEGMENTER.propose(images[0])[0]
    tracks = SEGMENTER.track(images, proposal.soft_mask[None])
    for image, mask in (
        (images[0], proposal.soft_mask > 0.5),
        (images[1], tracks.logits[1, 0] > 0),
    ):
        red, green, blue = image[:, mask].median(1).values
        assert red > 2 * max(green, blue)
    assert bool(tracks.present.all())
    assert float((tracks.logits[1] > 0).float().mean()) == pytest.approx(
        proposal.area, rel=0.2
    )


@pytest.mark.parametrize("content", [b"", b"not a network", bytes(range(256)) * 40])
def test_a_damaged_network_of_salience_is_one_sentence(content, tmp_path, monkeypatch):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    (tmp_path / "u2netp").mkdir()
    (tmp_path / "u2netp" / "u2netp.onnx").write_bytes(content)
    with pytest.raises(InputError, match=r"u2netp\.onnx: is no whole .* get u2netp"):
        SEGMENTER.segment_marks(PICTURE, Marks(positive=((0.5, 0.5),)))


class Nothing:
    """Stands in for the network of salience."""

    def setInput(self, pixels):
        self.shape = pixels.shape[2:]

    def getUnconnectedOutLayersNames(self):
        return ("out",)

    def forward(self, name):
        return np.zeros((1, 1, *self.shape), np.float32)


def test_the_network_of_salience_is_read_once_a_click_and_forgotten(
    tmp_path, monkeypatch
):
    read = []

    def counted(path):
        network = Nothing()
        read.append(weakref.ref(network))
        return network

    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    (tmp_path / "u2netp").mkdir()
    (tmp_path / "u2netp" / "u2netp.onnx").touch()
    monkeypatch.setattr(cv2.dnn, "readNetFromONNX", counted)
    build("segmenter", "classical").segment_marks(
        PICTURE, Marks(positive=((0.5, 0.5),))
    )
    assert len(read) == 1 and read[0]() is None
