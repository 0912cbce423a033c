from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from PIL import Image

from edit3r.contract.lens import Lens
from edit3r.kit.photos.framing import Frame, common_size, frame_for
from edit3r.kit.photos.intrinsics import Intrinsics, as_others_of_its_size

sizes = st.tuples(st.integers(1, 6000), st.integers(1, 6000))


@given(st.lists(sizes, min_size=1, max_size=6), st.sampled_from([None, 1, 256, 512]))
def test_every_photo_covers_the_common_size(photos, longest):
    target = common_size(photos, longest)
    assert min(target) >= 1 and (longest is None or max(target) <= longest)
    for size in photos:
        left, top, right, bottom = frame_for(size, target).box
        assert (
            0 <= left < right <= size[1] + 1e-9 and 0 <= top < bottom <= size[0] + 1e-9
        )
        assert left == pytest.approx(
            size[1] - right, abs=1e-6
        ) and top == pytest.approx(size[0] - bottom, abs=1e-6)


@pytest.mark.parametrize(
    "size", [(384, 512), (500, 741), (1, 1), (1, 1000), (3024, 4032)]
)
def test_photos_of_one_size_lose_nothing(size):
    assert common_size([size] * 3, None) == size
    frame = frame_for(size, common_size([size] * 3, 512))
    assert frame.cropped == 0


def test_the_shape_of_most_photos_wins_and_two_different_ones_meet_in_the_middle():
    assert common_size([(300, 400), (300, 400), (400, 300)], None) == (300, 400)
    assert common_size([(300, 400), (400, 300)], None) == (300, 300)


def test_a_huge_photo_among_small_ones_is_reduced_and_a_tiny_one_is_enlarged():
    assert common_size([(300, 400), (3000, 4000), (300, 400)], 512) == (300, 400)
    assert frame_for((30, 40), (300, 400)).scale == 10


@given(sizes, sizes)
def test_intrinsics_follow_the_crop_exactly(size, target):
    """A ray through a pixel of the original passes through the same spot of the crop."""
    frame = frame_for(size, target)
    intrinsics = torch.tensor(
        [[0.9, 0.01, 0.52], [0, 1.1, 0.47], [0, 0, 1]], dtype=torch.float64
    )
    followed = frame.follow(intrinsics)
    point = torch.tensor([0.1, -0.2, 1.0], dtype=torch.float64)
    x, y = (intrinsics @ point)[:2] * torch.tensor([size[1], size[0]])
    left, top, right, bottom = frame.box
    expected = torch.stack(((x - left) / (right - left), (y - top) / (bottom - top)))
    torch.testing.assert_close((followed @ point)[:2], expected)


def test_the_cut_shows_what_the_box_says():
    """A linear ramp stays the ramp that the box predicts, at every pixel centre."""
    ramp = np.tile(np.arange(200, dtype=np.uint8), (100, 1))
    frame = Frame((100, 200), (50.0, 0.0, 150.0, 100.0), (25, 25))
    cut = np.asarray(frame.cut(Image.fromarray(ramp)))
    np.testing.assert_allclose(cut[12], 50 + (np.arange(25) + 0.5) * 4 - 0.5, atol=0.51)


def test_a_cut_that_changes_nothing_returns_the_very_pixels():
    noise = np.random.default_rng(0).integers(0, 255, (7, 9, 3), dtype=np.uint8)
    assert (
        np.asarray(frame_for((7, 9), (7, 9)).cut(Image.fromarray(noise))) == noise
    ).all()


def test_reducing_averages_instead_of_skipping():
    stripes = np.zeros((64, 64), np.uint8)
    stripes[:, ::2] = 255
    cut = np.asarray(frame_for((64, 64), (8, 8)).cut(Image.fromarray(stripes)))
    assert np.abs(cut.astype(int) - 127).max() < 12


BARREL = Lens((0.8, 1.2), (0.52, 0.47), (-0.2, 0.03, 0.01, -0.005, 0.0))


def bent(lens, u, v):
    """Where the lens shows what a pinhole would show at (u, v): OpenCV's formula, written out."""
    (fx, fy), (cx, cy), (k1, k2, p1, p2, k3) = lens.focal, lens.centre, lens.distortion
    x, y = (u - cx) / fx, (v - cy) / fy
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    along = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    down = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
    return along * fx + cx, down * fy + cy


@given(st.floats(0.1, 0.9), st.floats(0.1, 0.9))
def test_a_place_on_a_bent_photo_is_found_on_the_straight_one(u, v):
    assert BARREL.undistorted_place(*bent(BARREL, u, v)) == pytest.approx(
        (u, v), abs=1e-4
    )


@pytest.mark.parametrize("place", [(0.2, 0.25), (0.75, 0.3), (0.3, 0.8), (0.5, 0.5)])
def test_a_straightened_photo_shows_what_a_pinhole_would(place):
    (u, v), (width, height) = bent(BARREL, *place), (400, 300)
    rows, columns = np.mgrid[:height, :width] + 0.5
    spot = np.exp(-((columns - u * width) ** 2 + (rows - v * height) ** 2) / 18)
    frame = Frame((height, width), (0, 0, width, height), (height, width), BARREL)
    shown = np.asarray(frame.cut(Image.fromarray((255 * spot).astype(np.uint8)))) / 255
    middle = (
        (shown * columns).sum() / shown.sum() / width,
        (shown * rows).sum() / shown.sum() / height,
    )
    assert middle == pytest.approx(place, abs=1.5e-3)


@pytest.mark.parametrize("k1, dark", [(0.1, True), (-0.1, False)])
def test_a_straightened_photo_has_no_dark_corners(k1, dark):
    lens, white = (
        Lens((0.9, 1.2), (0.5, 0.5), (k1, 0, 0, 0, 0)),
        Image.new("RGB", (400, 300), "white"),
    )
    assert (np.asarray(lens.undistorted(white)).min() == 0) == dark
    frame = frame_for((300, 400), (150, 200)).through(lens)
    assert np.asarray(frame.cut(white)).min() >= 250
    assert (frame.cropped > 0) == dark and frame.cropped < 0.15
    intrinsics = torch.tensor(
        [[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]], dtype=torch.float64
    )
    # the crop is centred, so all angles and the middle stay
    wider = (1 - frame.cropped) ** -0.5
    assert torch.allclose(
        frame.follow(intrinsics).diagonal()[:2], wider * intrinsics.diagonal()[:2]
    )


@pytest.mark.parametrize(
    "change",
    [
        {"focal": (0.0, 1.0)},
        {"centre": (float("nan"), 0.5)},
        {"distortion": (1e3, 0, 0, 0, 0)},
    ],
)
def test_a_lens_of_impossible_numbers_is_none(change):
    with pytest.raises(ValueError, match="expected"):
        Lens(
            **{
                "focal": (1.0, 1.0),
                "centre": (0.5, 0.5),
                "distortion": (0.1, 0, 0, 0, 0),
                **change,
            }
        )


def test_another_lens_of_a_photo_of_that_size_leaves_it_open_which_took_it():
    bent = Lens((1.0, 1.0), (0.5, 0.5), (0.1,))
    known = [Intrinsics(torch.eye(3).double(), "a", lens=bent) for _ in range(2)]
    unknown = Intrinsics(torch.eye(3).double(), "default", assumed=True)
    sizes = [(30, 40)] * 3
    assert as_others_of_its_size([*known, unknown], sizes, 2).lens == bent
    known[1] = replace(known[1], lens=None)
    assert as_others_of_its_size([*known, unknown], sizes, 2) is unknown
