from itertools import combinations

import cv2
import numpy as np
import pytest
from edit3r_geometry import features
from edit3r_geometry.cameras import CalibratedImage
from edit3r_geometry.features import (
    FoundFeatures,
    detect,
    detect_tilted,
    likely_pairs,
    match,
    match_tilted,
    shortened,
)
from edit3r_geometry.keypoints import Keypoints
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


def test_a_blank_photo_has_no_features_and_no_matches(photo):
    nothing = detect(np.full((64, 64, 3), 0.5, np.float32), 100, 768)
    assert len(nothing) == 0
    assert len(match(nothing, detect(photo, 100, 768), 0.85)) == 0


def test_a_feature_that_could_be_two_matches_neither():
    descriptors = np.eye(128, dtype=np.float32)[:2]
    twins = Keypoints(np.array([[1.0, 1], [9, 9]]), descriptors[[0, 0]])
    other = Keypoints(np.array([[1.0, 1], [5, 5]]), descriptors)
    assert len(match(other, twins, 0.85)) == 0


def test_a_match_found_twice_at_one_place_counts_once():
    descriptors = np.eye(128, dtype=np.float32)[:4]
    a = Keypoints(np.array([[1.0, 1], [1, 1], [5, 5], [7, 7]]), descriptors)
    assert len(match(a, a, 0.85)) == 3


def right_matches(points, seen, pairs, homography):
    """How many matches lie within two pixels of where the homography says."""
    expected = cv2.perspectiveTransform(points[pairs[:, 0]][None], homography)[0]
    return (np.linalg.norm(expected - seen[pairs[:, 1]], axis=1) < 2).sum()


@pytest.mark.slow
def test_a_wall_seen_from_aside_matches_where_images_are_tilted_first(photo):
    focal, angle = 300.0, np.radians(65)
    lens = np.array([[focal, 0, 128], [0, focal, 128], [0, 0, 1]])
    turn = cv2.Rodrigues(np.array([0, angle, 0]))[0]
    ahead = np.array([0, 0, 1.0])
    about_the_wall = turn + np.outer(ahead - turn @ ahead, ahead)
    homography = lens @ about_the_wall @ np.linalg.inv(lens)
    aside = cv2.warpPerspective(photo, homography, (256, 256), flags=cv2.INTER_AREA)
    images = (photo, aside)
    plain = [detect(image, 2000, 768) for image in images]
    tilted = [detect_tilted(image, 1000, 768) for image in images]
    groups = [[first, *more] for first, more in zip(plain, tilted)]
    pairs = match_tilted(*groups, longest=256)
    joined = [np.concatenate([group.points for group in one]) for one in groups]
    right = right_matches(*joined, pairs, homography)
    places, before = [keys.points for keys in plain], match(*plain, 0.85)
    assert right > 3 * right_matches(*places, before, homography)
    assert right > 0.85 * len(pairs)


def test_what_several_tilts_find_in_one_place_is_one_match():
    descriptors = np.eye(128, dtype=np.float32)[:2]
    places = np.array([[10.0, 10], [50, 50]])
    once = Keypoints(places, descriptors)
    near = Keypoints(places + 0.4, np.eye(128, dtype=np.float32)[2:4])
    pairs = match_tilted([once, near], [once, near], longest=512)
    assert pairs.tolist() == [[0, 0], [1, 1]]


def test_a_feature_found_in_a_tilted_image_alone_is_the_plain_one_at_its_place():
    descriptors = np.eye(128, dtype=np.float32)
    places = np.array([[10.0, 10], [50, 50]])
    tilted = Keypoints(places + 0.4, descriptors[4:6])
    a = [Keypoints(places, descriptors[:2]), tilted]
    b = [Keypoints(places, descriptors[2:4]), tilted]
    assert match_tilted(a, b, longest=512).tolist() == [[0, 0], [1, 1]]


def crowds(sizes, link):
    """Features of images in crowds that show 320 same ones each; two images share 64 others too."""
    rng = np.random.default_rng(0)

    def some(count):
        descriptors = rng.normal(size=(count, 128))
        return descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)

    shared, images = some(64), []
    for size in sizes:
        common = some(320)
        for _ in range(size):
            own = some(320)
            if len(images) in link:
                own[:64] = shared
            mixed = rng.permutation(np.concatenate([common, own]))
            places = rng.uniform(0, 500, (640, 2))
            images.append(Keypoints(places, mixed.astype(np.float32)))
    return images


def test_of_few_images_every_two_are_matched():
    images = crowds((10,), ())
    assert likely_pairs(images, 0.85) == list(combinations(range(10), 2))


def test_of_many_images_each_is_matched_with_those_most_like_it():
    images = crowds((7, 7, 7), ())
    pairs = likely_pairs(images, 0.85)
    for start in (0, 7, 14):  # each has six others in its crowd
        assert set(combinations(range(start, start + 7), 2)) <= set(pairs)
    assert len(pairs) == 3 * 21 + 2


def test_two_crowds_of_images_are_joined_where_they_are_most_alike():
    pairs = likely_pairs(crowds((10, 10), (4, 13)), 0.85)
    assert [(a, b) for a, b in pairs if a < 10 <= b] == [(4, 13)]
    assert len(pairs) < 10 * 9


def test_fewer_numbers_tell_the_same_features_apart():
    images = crowds((3,), ())
    short = shortened(images)
    for a, b in combinations(range(3), 2):
        long, few = (match(some[a], some[b], 0.85) for some in (images, short))
        both = set(map(tuple, long)) & set(map(tuple, few))
        assert len(both) >= 320 and len(few) <= len(long)
    assert {keys.descriptors.shape[1] for keys in short} == {features.DIRECTIONS}
    assert np.allclose(np.linalg.norm(short[0].descriptors, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(
    "count, longest, limits",
    [(10, 256, (2500, 640)), (11, 256, (2400, 384)), (11, 400, (2400, 512))],
)
def test_many_photos_are_enlarged_less_and_have_fewer_features(
    monkeypatch, count, longest, limits
):
    asked = []

    def seen(image, *given):
        asked.append(given)
        return crowds((1,), ())[0]

    monkeypatch.setattr(features, "detect", seen)
    black = CalibratedImage(np.zeros((8, longest, 3), np.float32), np.eye(3))
    features.find_features([black] * count, features.FeatureSettings(matches="sift"))
    assert asked == [limits] * count


def test_what_is_kept_of_compared_features_are_their_places():
    found = FoundFeatures(tuple(crowds((2,), ())), {(0, 1): np.zeros((3, 2), int)})
    bare = found.without_descriptors()
    for whole, kept in zip(found.keypoints, bare.keypoints):
        assert kept.points is whole.points and len(kept) == len(whole)
        assert kept.descriptors.nbytes == 0 and kept.descriptors.base is None
    assert bare.indices is found.indices


def test_an_image_without_pixels_keeps_its_size_and_lens_alone():
    image = CalibratedImage(np.ones((6, 8, 3), np.float32), 2 * np.eye(3))
    bare = image.without_pixels()
    assert bare.size == (6, 8) and bare.fov == image.fov
    assert bare.pixels.base is not image.pixels and not any(bare.pixels.strides)
