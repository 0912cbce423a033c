import numpy as np
import pytest
from edit3r_matching.features import Keypoints, detect, match
from skimage.data import camera


@pytest.fixture(scope="module")
def photo():
    grey = camera()[100:356, 100:356].astype(np.float32) / 255
    return np.repeat(grey[..., None], 3, axis=2)


def test_a_shifted_photo_matches_at_the_shift(photo):
    a, b = detect(photo[:, :-20], 1000, 768), detect(photo[:, 20:], 1000, 768)
    pairs = match(a, b, 0.85)
    moved = a.points[pairs[:, 0]] - b.points[pairs[:, 1]]
    assert len(pairs) > 100
    assert (np.linalg.norm(moved - (20, 0), axis=1) < 0.5).mean() > 0.95


def test_points_keep_to_pixel_centres_at_one_half(photo):
    """A photo and its mirror image have mirrored features, which holds for one convention only."""
    a, b = detect(photo, 500, 768), detect(photo[::-1, ::-1].copy(), 500, 768)
    pairs = match(a, b, 0.85)
    sums = a.points[pairs[:, 0]] + b.points[pairs[:, 1]]
    assert np.median(sums, axis=0) == pytest.approx((256, 256), abs=0.1)


def test_descriptors_have_unit_length(photo):
    assert np.allclose(
        np.linalg.norm(detect(photo, 200, 768).descriptors, axis=1), 1, atol=1e-5
    )


def test_a_blank_photo_has_no_features_and_no_matches(photo):
    nothing = detect(np.full((64, 64, 3), 0.5, np.float32), 100, 768)
    assert len(nothing) == 0
    assert len(match(nothing, detect(photo, 100, 768), 0.85)) == 0


def test_a_feature_that_could_be_two_matches_neither():
    descriptors = np.eye(128, dtype=np.float32)[:2]
    twins = Keypoints(np.array([[1.0, 1], [9, 9]]), descriptors[[0, 0]])
    assert (
        len(match(Keypoints(np.array([[1.0, 1], [5, 5]]), descriptors), twins, 0.85))
        == 0
    )


def test_a_match_found_twice_at_one_place_counts_once():
    descriptors = np.eye(128, dtype=np.float32)[:4]
    a = Keypoints(np.array([[1.0, 1], [1, 1], [5, 5], [7, 7]]), descriptors)
    assert len(match(a, a, 0.85)) == 3
