import cv2
import numpy as np
import pytest

from edit3r.kit.photos.triples import choose_triples, rotation_degrees


def pose(x, degrees):
    c2w = np.eye(4)
    c2w[:3, :3] = cv2.Rodrigues(np.array([0, np.radians(degrees), 0]))[0]
    c2w[0, 3] = x
    return c2w


def test_triples_are_pairs_of_the_wanted_angle_with_a_photo_between():
    cameras = [pose(x, -10 * x) for x in (0, 0.25, 0.5, 1, 5)]
    assert choose_triples(cameras, 9, (8, 30)) == [(0, 3, 2)]
    assert choose_triples(cameras[:2], 9) == []


def test_a_photo_that_looks_aside_is_between_no_pair():
    ends, aside = [pose(0, 0), pose(1, -10)], pose(0.5, 90)
    assert choose_triples([*ends, aside], 9, (8, 30)) == []
    assert choose_triples([*ends, aside, pose(0.6, -5)], 9, (8, 30)) == [(0, 1, 3)]


def test_triples_are_spread_over_all_pairs():
    cameras = [pose(0.1 * i, -2.5 * i) for i in range(12)]
    every = choose_triples(cameras, 999)
    few = choose_triples(cameras, 3)
    assert few == [every[0], few[1], every[-1]]


def test_rotation_degrees_is_exact_for_small_angles():
    turn = cv2.Rodrigues(np.array([0, np.radians(1e-4), 0]))[0]
    assert rotation_degrees(turn, np.eye(3)) == pytest.approx(1e-4, rel=1e-6)
