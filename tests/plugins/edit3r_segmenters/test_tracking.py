import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from edit3r.loading.registry import build

# pytest in importlib mode finds no neighbours
sys.path.insert(0, str(Path(__file__).parent))

from segmenter_scenes import backdrop, ellipse, iou, tensor, with_object

SEGMENTER = build("segmenter", "classical")
HEIGHT, WIDTH = 120, 160
MASK = ellipse(HEIGHT, WIDTH, (60, 60), (26, 22))


def view(
    shift: tuple[int, int] = (0, 0), colour=(0.85, 0.2, 0.15)
) -> tuple[torch.Tensor, np.ndarray]:
    """The object moved by (x, y) pixels in front of a background that stays, and its true mask."""
    mask = ellipse(HEIGHT, WIDTH, (60 + shift[0], 60 + shift[1]), (26, 22))
    return tensor(with_object(backdrop(), mask, colour, offset=shift)), mask


def track(*images: torch.Tensor, masks: tuple[np.ndarray, ...] = (MASK,)):
    return SEGMENTER.track(
        torch.stack(images), torch.from_numpy(np.stack(masks)).float()
    )


@pytest.mark.parametrize("shift", [(0, 0), (3, 1), (9, -5), (20, 8)])
def test_a_moved_object_is_followed(shift):
    moved, truth = view(shift)
    tracks = track(view()[0], moved)
    assert bool(tracks.present.all())
    assert iou(tracks.logits[1, 0].sigmoid(), truth) > 0.95


@pytest.mark.parametrize(
    "turn, zoom, shift",
    [(25, 1.0, (60, 10)), (0, 1.5, (-30, 0)), (-35, 0.75, (50, -20))],
)
def test_a_camera_that_moves_far_is_followed_by_features(turn, zoom, shift):
    """The whole picture turns, zooms and shifts, too far for flow."""
    first, _ = view()
    matrix = cv2.getRotationMatrix2D((60, 60), turn, zoom)
    matrix[:, 2] += shift
    picture = first.permute(1, 2, 0).numpy()
    second = cv2.warpAffine(
        picture, matrix, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT
    )
    truth = cv2.warpAffine(MASK.astype(np.float32), matrix, (WIDTH, HEIGHT))
    tracks = track(first, tensor(np.clip(second, 0, 1)))
    assert bool(tracks.present[1, 0])
    assert iou(tracks.logits[1, 0].sigmoid(), truth) > 0.9


@pytest.mark.slow
def test_views_are_followed_one_after_the_other():
    shifts = [(0, 0), (15, 3), (30, 6), (45, 9), (60, 12)]
    views = [view(shift) for shift in shifts]
    tracks = track(*[image for image, _ in views])
    assert all(
        iou(tracks.logits[index, 0].sigmoid(), truth) > 0.93
        for index, (_, truth) in enumerate(views)
    )


def test_objects_keep_their_numbers():
    other = ellipse(HEIGHT, WIDTH, (125, 85), (16, 14))
    images = [
        tensor(with_object(view(s)[0].permute(1, 2, 0).numpy(), other, (0.2, 0.2, 0.8)))
        for s in ((0, 0), (6, 0))
    ]
    for masks in ((MASK, other), (other, MASK)):
        tracks = track(*images, masks=masks)
        truths = [view((6, 0))[1] if mask is MASK else other for mask in masks]
        assert all(
            iou(tracks.logits[1, number].sigmoid(), truth) > 0.9
            for number, truth in enumerate(truths)
        )


def assert_lost(tracks, view: int, number: int = 0) -> None:
    assert (
        not bool(tracks.present[view, number])
        and float(tracks.logits[view, number].max()) <= 0
    )


def other_pictures() -> dict[str, torch.Tensor]:
    return {
        "nothing of the scene": tensor(backdrop(seed=77))[[2, 0, 1]],
        "black": torch.zeros(3, HEIGHT, WIDTH),
        "the background alone": tensor(backdrop()),
        "another object in its place": view(colour=(0.1, 0.2, 0.9))[0],
    }


@pytest.mark.parametrize("other", other_pictures())
def test_an_object_that_is_not_there_is_lost(other):
    tracks = track(view()[0], other_pictures()[other])
    assert bool(tracks.present[0, 0])
    assert_lost(tracks, 1)


def test_an_object_is_found_again_after_it_was_hidden():
    moved, truth = view((8, 2))
    tracks = track(view()[0], torch.zeros(3, HEIGHT, WIDTH), moved)
    assert_lost(tracks, 1)
    assert (
        bool(tracks.present[2, 0]) and iou(tracks.logits[2, 0].sigmoid(), truth) > 0.9
    )


def test_an_empty_mask_is_lost_everywhere():
    tracks = track(view()[0], view()[0], masks=(np.zeros((HEIGHT, WIDTH)),))
    assert_lost(tracks, 0)
    assert_lost(tracks, 1)


def test_view_0_keeps_the_given_soft_mask():
    soft = cv2.GaussianBlur(MASK.astype(np.float32), (0, 0), 2)
    tracks = track(view()[0], view((4, 0))[0], masks=(soft,))
    assert torch.allclose(
        tracks.logits[0, 0].sigmoid(), torch.from_numpy(soft), atol=2e-3
    )


def test_tracking_is_deterministic():
    views = [view()[0], view((60, 10))[0]]
    assert torch.equal(track(*views).logits, track(*views).logits)


def test_no_objects_give_empty_tracks():
    tracks = SEGMENTER.track(
        torch.stack([view()[0]] * 2), torch.zeros(0, HEIGHT, WIDTH)
    )
    assert tracks.logits.shape == (2, 0, HEIGHT, WIDTH) and tracks.present.shape == (
        2,
        0,
    )
