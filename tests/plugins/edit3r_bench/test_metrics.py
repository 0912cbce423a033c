"""Every measure, on inputs small enough to reckon by hand or against an independent
implementation.
"""

import math
from itertools import permutations

import numpy as np
import pytest
import torch
from edit3r_bench.metrics import (
    change_outside,
    edit_strength,
    edit_uptake,
    frechet_distance,
    kernel_distance,
    regions,
    sharpness,
    warped_difference,
    warped_image,
)
from scipy.linalg import sqrtm
from scipy.ndimage import gaussian_filter

from edit3r.contract.types import Cameras


@pytest.fixture
def picture():
    return np.random.default_rng(0).random((32, 40, 3)).astype(np.float32)


def test_regions_part_the_picture_by_distance_from_the_edit():
    masks = np.zeros((1, 60, 100))
    # an edit that blends softly is one, and a band of 5 pixels lies around it
    masks[:, 20:40, 30:60] = 0.5
    found = regions(masks)
    counts = [int(found[name].sum()) for name in ("edit", "band", "background")]
    assert counts == [600, 30 * 40 - 600, 6000 - 30 * 40]
    assert (sum(region.astype(int) for region in found.values()) == 1).all()
    assert found["edit"][0, 20, 30] and found["band"][0, 15, 25]
    assert found["background"][0, 14, 25]


def test_half_the_contrast_has_a_quarter_of_the_sharpness(picture):
    assert sharpness(picture, picture) == pytest.approx(1)
    assert sharpness(0.5 * picture + 0.2, picture) == pytest.approx(0.25)
    assert sharpness(gaussian_filter(picture, (1, 1, 0)), picture) < 0.05
    assert math.isnan(sharpness(picture, np.full_like(picture, 0.5)))


def test_sharpness_of_one_bright_pixel_is_the_laplacians_by_hand():
    spot, wide = np.zeros((9, 9, 3)), np.zeros((9, 9, 3))
    spot[4, 4] = 1  # Laplacian -4 and four ones: squares 16 + 4, mean 0
    wide[4, 4:6] = 1  # -3, -3 and six ones: squares 18 + 6
    assert sharpness(spot, wide) == pytest.approx(20 / 24)


def test_how_an_image_lies_in_memory_does_not_change_the_last_digit(picture):
    """It did where products of matrices made the grey image: two machines' reports differed."""
    apart = np.ascontiguousarray(picture.transpose(2, 0, 1)).transpose(1, 2, 0)
    together = np.ascontiguousarray(picture)
    smooth = gaussian_filter(together, (1, 1, 0))
    assert sharpness(apart, smooth) == sharpness(together, smooth)


@pytest.fixture
def photos():
    return np.random.default_rng(0).uniform(0.2, 0.6, (2, 40, 50, 3))


@pytest.fixture
def masks():
    masks = np.zeros((2, 40, 50))
    masks[:, :, :25] = 1
    return masks


def test_strength_of_a_uniform_change_is_that_change(photos):
    assert edit_strength(photos + 0.25, photos) == pytest.approx(0.25)


def test_nothing_done_has_no_strength_and_no_uptake(photos, masks):
    assert edit_strength(photos, photos, masks) == 0
    assert edit_uptake(photos, photos, photos + 0.1) == 0
    assert edit_uptake(photos + 0.1, photos, photos) == 0  # nothing was wished


def test_strength_ignores_fine_noise_and_counts_the_mask_alone(photos, masks):
    noise = np.random.default_rng(1).choice([-0.2, 0.2], photos.shape)
    assert edit_strength(photos + noise, photos) < 0.2 * np.abs(noise).mean() * 2.5
    far = photos.copy()
    far[:, :, 35:] += 0.3  # well away from the mask
    assert edit_strength(far, photos, masks) < 1e-6
    assert change_outside(far, photos, masks) == pytest.approx(0.3 * 15 / 25, rel=1e-6)


def test_uptake_is_the_share_of_the_instruction(photos, masks):
    instruction = photos + masks[..., None] * np.array([0.2, -0.1, 0.0])
    change = instruction - photos
    for done, share in (
        (change, 1),
        (change / 2, 0.5),
        (-change, -1),
        ([0, 0, 0.3], 0),
    ):
        uptake = edit_uptake(photos + np.array(done), photos, instruction, masks)
        assert uptake == pytest.approx(share)


def test_masks_that_leave_nothing_measure_nothing(photos):
    everything = np.ones(photos.shape[:3])
    assert np.isnan(change_outside(photos, photos, everything))
    assert np.isnan(edit_strength(photos, photos, 0 * everything))


SIZE, DEPTH, SHIFT = 32, 2.0, 0.5  # of a wall that two cameras look at straight


@pytest.fixture
def cameras():
    """The second stands `SHIFT` to the right: with fx = 1 the wall moves SHIFT / DEPTH = a quarter
    picture left.
    """
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = SHIFT
    k = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])
    return Cameras(c2w, k.expand(1, 2, 3, 3), (SIZE, SIZE))


@pytest.fixture
def wall():
    """What both see, 8 pixels apart."""
    texture = torch.rand(3, SIZE, SIZE + 8, generator=torch.Generator().manual_seed(0))
    return torch.stack((texture[:, :, :SIZE], texture[:, :, 8:]))


@pytest.fixture
def depths():
    return torch.full((2, SIZE, SIZE), DEPTH)


def test_a_picture_is_carried_to_where_the_other_camera_sees_it(wall, depths, cameras):
    carried, seen = warped_image(wall[1], depths[0], depths[1], cameras)
    assert not seen[:, :8].any() and seen[:, 8:].all()
    assert torch.allclose(carried[:, :, 8:], wall[0][:, :, 8:], atol=1e-5)


def test_one_wall_agrees_and_a_tinted_one_differs_by_the_tint(wall, depths, cameras):
    pairs = [(0, 1), (1, 0)]
    assert warped_difference(wall, depths, cameras, pairs) == pytest.approx(0, abs=1e-5)
    tinted = torch.stack((wall[0], wall[1] + 0.125))
    off = warped_difference(tinted, depths, cameras, pairs)
    assert off == pytest.approx(0.125, abs=1e-5)


def test_only_the_mask_counts(wall, depths, cameras):
    tinted = torch.stack((wall[0], wall[1].clone()))
    tinted[1, :, :16] += 0.5
    lower = torch.zeros(2, SIZE, SIZE)
    lower[:, 18:] = 1
    inside, outside = (
        warped_difference(tinted, depths, cameras, [(0, 1)], masks)
        for masks in (lower, 1 - lower)
    )
    assert inside == pytest.approx(0, abs=1e-5) and outside > 0.3


def textbook_frechet(a, b):
    """As FID is usually written: full covariances and a matrix square root."""
    one, other = (np.cov(x, rowvar=False) for x in (a, b))
    trace = np.trace(one + other - 2 * np.real(sqrtm(one @ other)))
    return ((a.mean(0) - b.mean(0)) ** 2).sum() + trace


def loop_kernel(a, b):
    """KID's unbiased estimator term by term."""

    def kernel(x, y):
        return (float(x @ y) / len(x) + 1) ** 3

    within = [np.mean([kernel(x, y) for x, y in permutations(z, 2)]) for z in (a, b)]
    return sum(within) - 2 * np.mean([kernel(x, y) for x in a for y in b])


@pytest.fixture
def features():
    rng = np.random.default_rng(0)
    mix = rng.normal(size=(12, 12))
    return rng.normal(size=(90, 12)) @ mix, 0.5 + rng.normal(size=(70, 12)) @ mix * 1.3


def test_distances_agree_with_the_matrix_square_root_and_the_double_loop(features):
    expected = textbook_frechet(*features), loop_kernel(*features)
    assert frechet_distance(*features) == pytest.approx(expected[0], rel=1e-6)
    assert kernel_distance(*features) == pytest.approx(expected[1], rel=1e-9)


def test_frechet_distance_is_exact_with_fewer_pictures_than_features():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(9, 40)), 0.3 + rng.normal(size=(7, 40))
    assert frechet_distance(a, b) == pytest.approx(textbook_frechet(a, b), rel=1e-3)


def test_equal_sets_are_at_distance_zero_and_order_does_not_matter(features):
    a, b = features
    tiny = 1e-9 * float(np.square(a).sum())
    assert frechet_distance(a, a[::-1]) == pytest.approx(0, abs=tiny)
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b[::-1], a))
    assert kernel_distance(a, b) == pytest.approx(kernel_distance(b[::-1], a))


@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
def test_a_single_picture_is_no_distribution(distance):
    with pytest.raises(ValueError, match="at least 2"):
        distance(np.zeros((1, 3)), np.zeros((4, 3)))
