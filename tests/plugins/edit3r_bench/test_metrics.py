"""Every measure, on inputs small enough to reckon by hand or against an independent
implementation.
"""

import math

import numpy as np
import pytest
import torch
from edit3r_bench.metrics import (
    blur,
    change_outside,
    edit_strength,
    edit_uptake,
    epipolar_distances,
    frechet_distance,
    kernel_distance,
    matched_points,
    regions,
    sharpness,
    warped_difference,
    warped_image,
)
from scipy.linalg import sqrtm
from scipy.ndimage import gaussian_filter

from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import project


@pytest.fixture
def picture():
    return np.random.default_rng(0).random((32, 40, 3)).astype(np.float32)


def test_regions_part_the_picture_by_distance_from_the_edit():
    masks = np.zeros((1, 60, 100))
    # an edit that blends softly is one, and a band of 5 pixels lies around it
    masks[:, 20:40, 30:60] = 0.5
    found = regions(masks)
    assert [int(found[name].sum()) for name in ("edit", "band", "background")] == [
        600,
        30 * 40 - 600,
        6000 - 30 * 40,
    ]
    assert (sum(region.astype(int) for region in found.values()) == 1).all()
    assert (
        found["edit"][0, 20, 30]
        and found["band"][0, 15, 25]
        and found["background"][0, 14, 25]
    )


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


def test_blur_rises_with_the_blur_and_stays_a_share(picture):
    values = [
        blur(gaussian_filter(picture, (sigma, sigma, 0)) if sigma else picture)
        for sigma in (0, 0.5, 1, 2, 4)
    ]
    assert values == sorted(values) and 0 <= values[0] < 0.2 and 0.5 < values[-1] <= 1
    assert blur(np.full((32, 32, 3), 0.5)) == 1


def test_how_an_image_lies_in_memory_does_not_change_the_last_digit(picture):
    """It did where products of matrices made the grey image: two machines' reports differed."""
    apart = np.ascontiguousarray(picture.transpose(2, 0, 1)).transpose(1, 2, 0)
    together = np.ascontiguousarray(picture)
    assert blur(apart) == blur(together)
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
    assert edit_uptake(instruction, photos, instruction, masks) == pytest.approx(1)
    assert edit_uptake(
        photos + 0.5 * (instruction - photos), photos, instruction, masks
    ) == pytest.approx(0.5)
    assert edit_uptake(
        photos - (instruction - photos), photos, instruction, masks
    ) == pytest.approx(-1)
    assert edit_uptake(
        photos + np.array([0, 0, 0.3]), photos, instruction, masks
    ) == pytest.approx(0)


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
    assert warped_difference(tinted, depths, cameras, pairs) == pytest.approx(
        0.125, abs=1e-5
    )


def test_only_the_mask_counts(wall, depths, cameras):
    tinted = torch.stack((wall[0], wall[1].clone()))
    tinted[1, :, :16] += 0.5
    lower = torch.zeros(2, SIZE, SIZE)
    lower[:, 18:] = 1
    assert warped_difference(tinted, depths, cameras, [(0, 1)], lower) == pytest.approx(
        0, abs=1e-5
    )
    assert warped_difference(tinted, depths, cameras, [(0, 1)], 1 - lower) > 0.3


def test_hidden_points_do_not_count(wall, depths, cameras):
    hiding = depths.clone()
    hiding[1] = 1.0  # the second camera sees something nearer everywhere
    assert warped_difference(wall, hiding, cameras, [(0, 1)]) != warped_difference(
        wall, hiding, cameras, [(0, 1)]
    )


TILTED = math.radians(10)


@pytest.fixture
def two_cameras():
    """The second stands to the right and ahead and looks 10 degrees to the left; unlike lenses,
    wide pictures.
    """
    c2w = torch.eye(4, dtype=torch.float64).repeat(1, 2, 1, 1)
    c2w[0, 1, :3, 3] = torch.tensor([0.6, 0.1, 0.2])
    cosine, sine = math.cos(TILTED), math.sin(TILTED)
    c2w[0, 1, :3, :3] = torch.tensor([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    k = torch.tensor(
        [
            [[1.0, 0, 0.5], [0, 1.5, 0.5], [0, 0, 1]],
            [[1.2, 0, 0.45], [0, 1.8, 0.55], [0, 0, 1]],
        ]
    )
    return Cameras(c2w.float(), k[None], (80, 120))


def seen_by(cameras, points):
    places = project(points.expand(2, -1, -1), cameras.intrinsics[0], cameras.c2w[0])[0]
    return [(own * torch.tensor([120.0, 80.0])).double().numpy() for own in places]


def test_true_matches_lie_on_their_epipolar_lines(two_cameras):
    points = torch.rand(
        40, 3, generator=torch.Generator().manual_seed(0)
    ) * 2 + torch.tensor([-1.0, -1.0, 3.0])
    first, second = seen_by(two_cameras, points)
    assert epipolar_distances(first, second, two_cameras).max() < 1e-3
    # views swapped
    assert np.median(epipolar_distances(second, first, two_cameras)) > 1
    other_way = Cameras(
        torch.linalg.inv(two_cameras.c2w),
        two_cameras.intrinsics,
        two_cameras.image_size,
    )
    # world-to-camera instead
    assert np.median(epipolar_distances(first, second, other_way)) > 1
    far = Cameras(
        two_cameras.c2w.clone(), two_cameras.intrinsics, two_cameras.image_size
    )
    far.c2w[..., :3, 3] *= 7
    # the unit of length does not matter
    assert epipolar_distances(first, second, far).max() < 1e-3


def test_a_match_that_is_off_across_its_line_is_off_by_that(cameras):
    # Straight ahead and one beside the other, epipolar lines are rows: 2 down is 2 pixels, along
    # the row is nothing.
    first = np.array([[10.0, 12.0], [20.0, 5.0], [8.0, 8.0]])
    second = first + np.array([[-8.0, 2.0], [-3.0, 0.0], [-4.0, -1.0]])
    assert epipolar_distances(first, second, cameras) == pytest.approx([2, 0, 1])


def test_points_of_a_moved_picture_are_matched_where_they_went():
    image = gaussian_filter(np.random.default_rng(0).random((96, 96, 3)), (2, 2, 0))
    image = (image - image.min()) / np.ptp(image)
    first, second = matched_points(image[:, :80], image[:, 9:89])
    assert len(first) > 20
    assert np.abs(second - first - np.array([-9.0, 0.0])).max(1).mean() < 0.2
    assert len(matched_points(image[:, :80], np.full((96, 80, 3), 0.5))[0]) == 0
    assert (
        len(matched_points(image[:48], np.random.default_rng(1).random((48, 96, 3)))[0])
        < 5
    )


def test_what_is_there_twice_is_matched_once():
    patch = gaussian_filter(np.random.default_rng(0).random((40, 40, 3)), (1.5, 1.5, 0))
    patch = (patch - patch.min()) / np.ptp(patch)
    once, twice = np.full((60, 120, 3), 0.5), np.full((60, 120, 3), 0.5)
    once[10:50, 10:50] = twice[10:50, 10:50] = twice[10:50, 70:110] = patch
    assert (
        10
        < len(matched_points(twice, once)[0])
        <= 1.1 * len(matched_points(once, once)[0])
    )


def test_a_match_counts_from_the_corner_of_the_picture():
    rows, columns = np.mgrid[:64, :96]
    # column and row of the pixel in the middle, width
    spots = [
        (20, 30, 3.0),
        (60, 24, 5.0),
        (40, 50, 4.0),
    ]
    grey = sum(
        np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * w**2))
        for x, y, w in spots
    )
    image = np.repeat(grey[..., None], 3, -1).clip(0, 1)
    found = matched_points(image, image)[0]
    for x, y, _ in spots:
        # OpenCV's SIFT is a quarter of a pixel off
        assert np.abs(found - [x + 0.5, y + 0.5]).max(1).min() < 0.3


def textbook_frechet(a, b):
    """As FID is usually written: full covariances and a matrix square root."""
    root = sqrtm(np.cov(a, rowvar=False) @ np.cov(b, rowvar=False))
    trace = np.trace(
        np.cov(a, rowvar=False) + np.cov(b, rowvar=False) - 2 * np.real(root)
    )
    return ((a.mean(0) - b.mean(0)) ** 2).sum() + trace


def loop_kernel(a, b):
    """KID's unbiased estimator term by term."""

    def kernel(x, y):
        return (float(x @ y) / len(x) + 1) ** 3

    within_a = np.mean(
        [kernel(x, y) for i, x in enumerate(a) for j, y in enumerate(a) if i != j]
    )
    within_b = np.mean(
        [kernel(x, y) for i, x in enumerate(b) for j, y in enumerate(b) if i != j]
    )
    return within_a + within_b - 2 * np.mean([kernel(x, y) for x in a for y in b])


@pytest.fixture
def features():
    rng = np.random.default_rng(0)
    mix = rng.normal(size=(12, 12))
    return rng.normal(size=(90, 12)) @ mix, 0.5 + rng.normal(size=(70, 12)) @ mix * 1.3


def test_frechet_distance_of_two_hand_made_lines():
    # Means 1 and 4, unbiased variances 2 and 8: (1 - 4)^2 + 2 + 8 - 2 sqrt(2 * 8) = 11
    assert frechet_distance(
        np.array([[0.0], [2.0]]), np.array([[2.0], [6.0]])
    ) == pytest.approx(11.0)


def test_kernel_distance_of_hand_made_points():
    # One feature: within {0, 1}: (0 + 1)^3 = 1; within {1, 2}: (2 + 1)^3 = 27; across: (1 + 1 + 8 +
    # 27) / 4
    value = kernel_distance(np.array([[0.0], [1.0]]), np.array([[1.0], [2.0]]))
    assert value == pytest.approx(1 + 27 - 2 * (1 + 1 + 8 + 27) / 4)


def test_frechet_distance_agrees_with_the_matrix_square_root(features):
    assert frechet_distance(*features) == pytest.approx(
        textbook_frechet(*features), rel=1e-6
    )


def test_kernel_distance_agrees_with_the_double_loop(features):
    assert kernel_distance(*features) == pytest.approx(loop_kernel(*features), rel=1e-9)


def test_frechet_distance_is_exact_with_fewer_pictures_than_features():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(9, 40)), 0.3 + rng.normal(size=(7, 40))
    assert frechet_distance(a, b) == pytest.approx(textbook_frechet(a, b), rel=1e-3)


def test_equal_sets_are_at_distance_zero_and_order_does_not_matter(features):
    a, b = features
    assert frechet_distance(a, a[::-1]) == pytest.approx(
        0, abs=1e-9 * float(np.square(a).sum())
    )
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b[::-1], a))
    assert kernel_distance(a, b) == pytest.approx(kernel_distance(b[::-1], a))


def test_kernel_distance_of_one_distribution_is_about_zero():
    rng = np.random.default_rng(2)
    values = [kernel_distance(*rng.normal(size=(2, 30, 16))) for _ in range(40)]
    assert abs(np.mean(values)) < 3 * np.std(values) / np.sqrt(len(values))


@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
def test_a_single_picture_is_no_distribution(distance):
    with pytest.raises(ValueError, match="at least 2"):
        distance(np.zeros((1, 3)), np.zeros((4, 3)))
