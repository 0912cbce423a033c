import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from edit3r_geometry import calibration
from edit3r_geometry.calibration import USUAL_FOV, calibrate, contradiction
from edit3r_geometry.cameras import CalibratedImage, Pose, rays_through
from edit3r_geometry.matchers import ClassicalMatcher
from edit3r_geometry.relative_pose import Matches

SIDE = 256
TURNING = (0.05, 0.35, 0.02), (-1, 0.1, 0.3)  # how a camera turns and moves


def lens(fov):
    focal = 0.5 * SIDE / math.tan(math.radians(fov) / 2)
    return np.array([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1]])


def matches(fov, turn, shift, noise=0.2, outliers=0.3, count=400):
    """Points seen by two cameras of `fov` degrees, as rays of cameras taken to have 60; a share of
    them thrown.
    """
    random = np.random.default_rng(1)
    depth = random.uniform(2, 8, count)
    first = random.uniform(10, SIDE - 10, (count, 2))
    points = rays_through(first, lens(fov)) * depth[:, None]
    moved = points @ cv2.Rodrigues(np.array(turn, float))[0].T + np.array(shift, float)
    second = (moved @ lens(fov).T)[:, :2] / moved[:, 2:]
    first, second = (x + random.normal(0, noise, x.shape) for x in (first, second))
    thrown = random.random(count) < outliers
    second[thrown] = random.uniform(0, SIDE, (thrown.sum(), 2))
    rays = (rays_through(places, lens(60)) for places in (first, second))
    return Matches(*rays, float(lens(60)[0, 0]), 0.01)


def contradicted(found):
    """What a camera that is said to have 60 degrees is told."""
    photo = CalibratedImage(np.zeros((SIDE, SIDE, 3), np.float32), lens(60))
    return contradiction([photo, photo], {(0, 1): found}, 1.0, 0)


def reading(found, threshold=1.0, **options):
    photo = CalibratedImage(np.zeros((SIDE, SIDE, 3), np.float32), lens(60))
    pairs = found if isinstance(found, dict) else {(0, 1): found}
    return calibrate([photo, photo, photo], pairs, threshold, 0, **options)


def read(found, threshold=1.0, **options):
    told = reading(found, threshold, **options)
    return None if told is None else told.fov


def test_a_motion_that_every_quick_estimate_misses_is_found(monkeypatch):
    away = Pose(cv2.Rodrigues(np.array((0, 0, 1.0)))[0], np.array((0, 0, 1.0)))
    monkeypatch.setattr(calibration, "quick_pose", lambda *_: away)
    found = read(matches(90, (0.05, 0.35, 0.02), (-1, 0.1, 0.3)))
    assert found == pytest.approx(90, abs=4)


@pytest.mark.slow
@pytest.mark.parametrize("fov", [24, 35, 60, 90, 113])
def test_the_field_of_view_is_read_from_a_camera_that_turns_and_moves(fov):
    found = read(matches(fov, *TURNING))
    assert found == pytest.approx(fov, abs=4)


@pytest.mark.slow
@pytest.mark.parametrize("fov", [40, 60, 90])
def test_a_camera_that_only_moved_sideways_has_a_usual_lens_and_is_unsure(fov):
    """Every focal length explains such matches, so the likeliest is a usual one."""
    told = reading(matches(fov, (0, 0, 0), (-1, 0, 0)))
    assert told.fov == pytest.approx(USUAL_FOV, abs=8)
    assert told.alike[0] < 40 and told.alike[1] > 80
    assert reading(matches(60, *TURNING)).alike is None


@pytest.mark.slow
def test_the_pairs_that_tell_are_asked_and_not_those_with_most_matches():
    still = matches(113, (0, 0.02, 0), (-0.01, 0, 0), count=900, outliers=0)
    pairs = {(0, view): still for view in range(1, 6)}
    pairs[1, 2] = matches(113, *TURNING)
    assert read(pairs) == pytest.approx(113, abs=6)


@pytest.mark.slow
def test_where_nobody_knows_the_lens_what_was_assumed_does_not_count():
    found = matches(60, (0.01, 0.02, 0), (-1, 0.1, 0.1), count=120)
    said = [replace(found, focal=found.focal), found.zoomed(1.6)]
    assert read(said[0]) == pytest.approx(read(said[1]), abs=1.5)


@pytest.mark.slow
def test_matches_that_agree_on_no_motion_tell_nothing():
    assert read(matches(60, (0, 0.1, 0), (-1, 0, 0), outliers=1.0)) is None
    assert read(matches(60, (0, 0.1, 0), (-1, 0, 0), count=20)) is None


@pytest.mark.slow
@pytest.mark.parametrize("fov", [38, 80])
def test_a_field_of_view_far_from_what_the_photos_tell_is_contradicted(fov):
    told = contradicted(matches(fov, *TURNING))
    assert told == pytest.approx(fov, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "found",
    [
        pytest.param(matches(60, *TURNING), id="right"),
        pytest.param(matches(54, *TURNING), id="a tenth narrower"),
        pytest.param(matches(66, *TURNING), id="a tenth wider"),
        pytest.param(matches(40, (0, 0, 0), (-1, 0, 0)), id="moved sideways"),
        pytest.param(matches(40, *TURNING, count=60), id="few matches"),
        pytest.param(
            matches(40, (0, 0.1, 0), (-1, 0, 0), outliers=1.0), id="no motion"
        ),
        pytest.param(matches(132, *TURNING), id="wider than any that is tried"),
    ],
)
def test_what_is_nearly_right_or_cannot_be_told_is_not_contradicted(found):
    assert contradicted(found) is None


@pytest.mark.slow
def test_the_matcher_reads_it_only_where_nobody_knows_the_lens(make_room):
    pair = make_room([(0,), (0.5, 0.1, -12)])
    wrong = pair.views.intrinsics.clone()
    wrong[..., 0, 0] *= 0.7
    wrong[..., 1, 1] *= 0.7
    matcher = ClassicalMatcher(ClassicalMatcher.Settings(working_size=96, planes=24))
    with pytest.warns(UserWarning, match="not the 77 that were given"):
        believed = matcher.match(replace(pair.views, intrinsics=wrong))
    assert believed.intrinsics is None and believed.contradicting_fov < 65
    half = replace(pair.views, intrinsics=wrong, assumed=(True, False))
    assert matcher.match(half).intrinsics is None
    views = replace(pair.views, intrinsics=wrong, assumed=(True, True))
    told = matcher.match(views).calibrated(views).intrinsics[0, 0, 0, 0]
    true = pair.views.intrinsics[0, 0, 0, 0]
    assert torch.isclose(told, true, rtol=0.15)
    assert abs(told - true) < abs(wrong[0, 0, 0, 0] - true)
