"""Photos from wide apart: what counts as a motion there, and how three in a row are joined."""

import cv2
import numpy as np
import pytest
from edit3r_geometry import registration
from edit3r_geometry.cameras import CalibratedImage, Pose, project
from edit3r_geometry.features import FoundFeatures
from edit3r_geometry.keypoints import Keypoints

from edit3r.contract.errors import MatchingError

FOCAL, SIZE = 300.0, (240, 320)
LENS = np.array([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
MIDDLE = np.array([0, 0, 6.0])
NOISE = 0.3  # [pixels]


def around(degrees):
    """World to camera of one that looks at the middle from 6 away."""
    turn = cv2.Rodrigues(np.array([0, np.radians(degrees), 0]))[0]
    return Pose(turn, MIDDLE - turn @ MIDDLE)


POSES = {view: around(35 * view) for view in range(3)}


def wavy(count, seed, width=2.0):
    """Points of a wavy wall through the middle."""
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(-width, width, (count, 2)), np.zeros(count)))
    points[:, 2] = MIDDLE[2] + 0.4 * np.sin(2 * points[:, 0]) + 0.3 * points[:, 1]
    return points


def seen(points, view, seed=0):
    places = project(POSES[view].apply(points), LENS)
    return places + np.random.default_rng(seed + view).normal(0, NOISE, places.shape)


def keypoints(places):
    return Keypoints(places, np.zeros((len(places), 128), np.float32))


def images(count):
    image = CalibratedImage(np.zeros((*SIZE, 3), np.float32), LENS)
    return [image] * count


def same(count, start=0):
    return np.stack([np.arange(start, start + count)] * 2, axis=1)


def chain(deeper=None, tilted=True, order=(0, 1, 2)):
    """Three views in a row: the first two share 150 points of a wall, the last two 150 others.

    `deeper` [150] moves each of the last ones away from the middle view by a factor, which that
    view cannot see. `order` says which view is given first, second and third.
    """
    first, last = wavy(150, 1), wavy(150, 2)
    if deeper is not None:
        middle = POSES[1]
        last = middle.inverse().apply(middle.apply(last) * deeper[:, None])
    keys = (
        keypoints(seen(first, 0)),
        keypoints(np.concatenate((seen(first, 1), seen(last, 1, 9)))),
        keypoints(seen(last, 2, 9)),
    )
    places = [order.index(view) for view in range(3)]
    joined = np.column_stack((np.arange(150, 300), np.arange(150)))
    shared = {
        tuple(sorted(places[:2])): same(150),
        tuple(sorted(places[1:])): joined[:, :: 1 if places[1] < places[2] else -1],
    }
    found = FoundFeatures([keys[view] for view in order], shared, tilted=tilted)
    return registration.register(images(3), "abc", found, threshold=1.0, seed=0)


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1)])
def test_three_in_a_row_without_a_common_point_are_joined_by_points_near_each_other(
    order,
):
    result = chain(order=order)
    assert result.registered.all()
    poses = [result.poses[order.index(view)] for view in range(3)]
    for view, true in POSES.items():
        turn = cv2.Rodrigues(poses[view].rotation @ true.rotation.T)[0]
        assert np.degrees(np.linalg.norm(turn)) < 1
    centres = np.stack([pose.inverse().translation for pose in poses])
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    assert steps[1] / steps[0] == pytest.approx(1, abs=0.05)


def test_of_few_photos_those_that_were_not_tilted_are_not_joined_so(monkeypatch):
    assert chain(tilted=False).registered.tolist() == [True, True, False]
    monkeypatch.setattr(registration, "MAX_LEARNED", 2)  # three photos are many then
    assert chain(tilted=False).registered.all()


def test_depths_that_tell_no_common_scale_join_nothing():
    deeper = np.random.default_rng(4).uniform(0.6, 1.6, 150)
    assert chain(deeper=deeper).registered.tolist() == [True, True, False]


def test_where_only_the_first_photo_matches_none_the_message_says_which_to_give_first():
    points = wavy(150, 1)
    places = np.zeros((0, 2)), seen(points, 1), seen(points, 2)
    keys = tuple(map(keypoints, places))
    none = same(0)
    indices = {(0, 1): none, (0, 2): none, (1, 2): same(150)}
    advice = "b, c match among themselves: give b first, and a is left out"
    with pytest.raises(MatchingError, match=advice):
        found = FoundFeatures(keys, indices)
        registration.register(images(3), "abc", found, threshold=1.0, seed=0)


def placed(points, noise, tilted):
    """Register two views of `points` with wrong matches, half an image apart in y."""
    first = np.random.default_rng(3).uniform((0, 0), SIZE[::-1], (noise, 2))
    by_chance = [first, (first + np.array((0, SIZE[0] / 2))) % SIZE[::-1]]
    places = (np.concatenate((seen(points, v), by_chance[v])) for v in (0, 1))
    keys = tuple(map(keypoints, places))
    found = FoundFeatures(keys, {(0, 1): same(len(points) + noise)}, tilted=tilted)
    return registration.register(images(2), "ab", found, threshold=1.0, seed=0)


def test_few_matches_are_not_believed_where_images_were_tilted():
    few = wavy(20, 5)
    assert placed(few, 0, tilted=False).registered.all()
    with pytest.raises(MatchingError, match="too few to be sure"):
        placed(few, 0, tilted=True)


def in_the_middle(width):
    """80 points about the middle, not flat."""
    part = wavy(80, 6, width)
    part[:, 2] = MIDDLE[2] + np.random.default_rng(7).uniform(-0.5, 0.5, 80)
    return part


def test_a_small_part_in_common_is_believed_of_wide_photos_unless_it_is_flat():
    part = in_the_middle(1.3)
    with pytest.raises(MatchingError, match="as on a poster"):
        placed(part, 60, tilted=False)
    assert placed(part, 60, tilted=True).registered.all()
    part[:, 2] = MIDDLE[2] + 0.3 * part[:, 1]
    with pytest.raises(MatchingError, match="as on a poster"):
        placed(part, 60, tilted=True)


def test_what_lies_close_together_in_both_photos_is_not_believed_where_images_were_tilted():
    """Stray matches (4 of 84) do not make it look wide."""
    together = np.concatenate((in_the_middle(0.6), wavy(4, 8)))
    with pytest.raises(MatchingError, match="close together"):
        placed(together, 15, tilted=True)


def test_what_lies_close_together_is_believed_where_nearly_all_matches_agree():
    assert placed(in_the_middle(0.6), 5, tilted=True).registered.all()
