"""Bundle adjustment finds the poses that the pixels were made with, whatever order or outliers the
matches have.
"""

import signal
import subprocess
import sys
from itertools import combinations

import cv2
import numpy as np
import pytest
from edit3r_geometry import bundle_adjustment, registration
from edit3r_geometry.bundle_adjustment import adjust, fit_distortion, join_tracks
from edit3r_geometry.cameras import CalibratedImage, Pose, project, rays_through
from edit3r_geometry.features import FoundFeatures
from edit3r_geometry.keypoints import Keypoints
from edit3r_geometry.pairs import PairView, agreeing_pairs
from edit3r_geometry.relative_pose import Matches

from edit3r.contract.errors import MatchingError
from edit3r.kit.photos.triples import rotation_degrees

VIEWS, POINTS, FOCAL, SIZE = 4, 120, 300.0, (240, 320)
ASIDE = Pose(cv2.Rodrigues(np.array([0.0, 0.3, 0]))[0], np.array([-1.5, 0.1, 0.2]))


@pytest.fixture
def scene():
    """Images of a camera that moves past a cloud of points: (images, keypoints, matches, true
    poses).
    """
    rng = np.random.default_rng(0)
    points = rng.uniform((-2, -1.5, 4), (2, 1.5, 8), (POINTS, 3))
    k = np.array([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
    image = CalibratedImage(np.zeros((*SIZE, 3), np.float32), k)
    poses = {}
    for v in range(VIEWS):
        turn = cv2.Rodrigues(v * np.array([0.02, -0.08, 0.01]))[0]
        poses[v] = Pose(turn, -turn @ np.array([0.5 * v, 0.1 * v * v, 0.05 * v]))
    keypoints = [project(pose.apply(points), k) for pose in poses.values()]
    same = np.stack([np.arange(POINTS)] * 2, 1)
    matches = {pair: same for pair in combinations(range(VIEWS), 2)}
    return [image] * VIEWS, keypoints, matches, poses


def keys_of(places):
    """Keypoints whose descriptors say nothing."""
    return Keypoints(places, np.zeros((len(places), 128), np.float32))


def disturbed(poses, angle=0.01, shift=0.03):
    rng = np.random.default_rng(1)
    moved = {0: poses[0]}
    for view in range(1, len(poses)):
        turn = cv2.Rodrigues(rng.normal(0, angle, 3))[0]
        place = poses[view].translation + rng.normal(0, shift, 3)
        moved[view] = Pose(turn @ poses[view].rotation, place)
    return moved


def errors(found, true):
    """Largest rotation error [degrees], and largest error of a camera's place after scaling."""
    turns = [rotation_degrees(found[v].rotation, true[v].rotation) for v in true]
    own, other = (
        np.stack([poses[v].inverse().translation for v in poses])
        for poses in (found, true)
    )
    own = own * np.linalg.norm(other) / np.linalg.norm(own)
    return max(turns), float(np.abs(own - other).max())


def test_disturbed_poses_come_back(scene):
    images, keypoints, matches, true = scene
    before = disturbed(true)
    after = adjust(images, keypoints, matches, before, threshold=2.0)[0]
    assert errors(before, true)[0] > 0.5
    assert errors(after, true)[0] < 0.01 and errors(after, true)[1] < 1e-3
    assert np.allclose(after[0].matrix, np.eye(4))


def test_wrong_matches_and_noise_do_little(scene):
    images, keypoints, matches, true = scene
    rng = np.random.default_rng(2)
    noisy = [points + rng.normal(0, 0.3, points.shape) for points in keypoints]
    noisy[2][:12] += rng.uniform(20, 60, (12, 2))
    after = adjust(images, noisy, matches, disturbed(true), threshold=2.0)[0]
    assert errors(after, true)[0] < 0.25


def test_the_unit_of_length_stays_that_of_the_given_poses(scene):
    images, keypoints, matches, true = scene
    large = {v: Pose(pose.rotation, 100 * pose.translation) for v, pose in true.items()}
    after = adjust(images, keypoints, matches, large, threshold=2.0)[0]
    assert np.allclose(after[3].translation, large[3].translation, rtol=1e-3)


def test_views_without_a_pose_are_left_alone(scene):
    images, keypoints, matches, true = scene
    known = {v: pose for v, pose in disturbed(true).items() if v != 2}
    after = adjust(images, keypoints, matches, known, threshold=2.0)[0]
    assert sorted(after) == [0, 1, 3]
    assert errors(after, {v: true[v] for v in after})[0] < 0.01


def test_no_match_at_all_leaves_the_poses_as_they_are(scene):
    images, keypoints, _, true = scene
    after = adjust(images, keypoints, {}, true, threshold=2.0)[0]
    assert all(np.allclose(after[v].matrix, true[v].matrix) for v in true)


@pytest.mark.parametrize("wrong", [0.9, 1.1])
def test_a_focal_length_that_nobody_knows_comes_back_with_the_poses(scene, wrong):
    images, keypoints, matches, true = scene
    taken = [image.zoomed(wrong) for image in images]
    given = taken, keypoints, matches, disturbed(true)
    fixed, kept = adjust(*given, threshold=2.0)
    poses, zoom = adjust(*given, threshold=2.0, free_focal=True)
    assert kept == 1 and zoom * wrong == pytest.approx(1, abs=0.005)
    assert errors(poses, true)[0] < 0.05 < errors(fixed, true)[0]


def test_a_focal_length_that_runs_away_is_left_as_it_was(scene):
    images, keypoints, matches, true = scene
    taken = [image.zoomed(1.6) for image in images]
    given = taken, keypoints, matches, true
    poses, zoom = adjust(*given, threshold=4.0, free_focal=True)
    fixed = adjust(*given, threshold=4.0)[0]
    assert zoom == 1 and all((poses[v].matrix == fixed[v].matrix).all() for v in true)


@pytest.mark.parametrize("radial", [-0.12, 0.0, 0.06])
def test_the_distortion_of_one_lens_is_read_and_none_is_made_up(scene, radial):
    images, keypoints, matches, true = scene
    k, rng = images[0].K, np.random.default_rng(8)
    rays = [(points - k[:2, 2]) / FOCAL for points in keypoints]
    bent = [ray * (1 + radial * (ray**2).sum(1, keepdims=True)) for ray in rays]
    noisy = [FOCAL * ray + k[:2, 2] + rng.normal(0, 0.1, ray.shape) for ray in bent]
    taken = [image.zoomed(1.04) for image in images]
    found, gain = fit_distortion(taken, noisy, matches, disturbed(true), threshold=2.0)
    assert found == pytest.approx(radial, abs=0.02)
    assert gain > 0.15 if radial else abs(gain) < 0.03


def test_matches_that_share_a_keypoint_are_one_track_and_those_of_most_views_are_first():
    keypoints = [np.zeros((3, 2))] * 3
    matches = {(0, 1): np.array([[0, 2], [1, 1]]), (1, 2): np.array([[2, 0]])}
    assert join_tracks(matches, keypoints) == [{0: 0, 1: 2, 2: 0}, {0: 1, 1: 1}]


def test_a_track_that_sees_a_view_twice_is_left_out():
    ways = {(0, 1): [[0, 0]], (1, 2): [[0, 0]], (0, 2): [[1, 0]]}
    matches = {pair: np.array(way) for pair, way in ways.items()}
    assert join_tracks(matches, [np.zeros((3, 2))] * 3) == []


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM on Windows")
@pytest.mark.parametrize(
    "where", ["load()", "(t := threading.Thread(target=load)).start(); t.join()"]
)
def test_a_process_that_is_ended_prints_no_stack_trace(where):
    load = (
        "import sys, threading, time; load = lambda: "
        "__import__('edit3r_geometry.bundle_adjustment')"
    )
    code = f"{load}; {where}; print(1, flush=True); time.sleep(60)"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.readline()
    process.terminate()
    assert process.communicate(timeout=60)[1] == b""
    assert process.returncode == -signal.SIGTERM


@pytest.fixture
def surface():
    """Two images of 300 points on a wavy wall: (images, pixels in both)."""
    rng = np.random.default_rng(4)
    places = rng.uniform((-2, -1.5), (2, 1.5), (300, 2))
    points = np.column_stack((places, 5 + 0.5 * np.sin(places[:, 0])))
    k = np.array([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
    image = CalibratedImage(np.zeros((*SIZE, 3), np.float32), k)
    return [image] * 2, (project(points, k), project(ASIDE.apply(points), k))


def placed(images, pixels, count, sift):
    """Whether `count` matches, the first `sift` of them SIFT's and the others learned, place the
    two images.
    """
    same = {(0, 1): np.stack([np.arange(count)] * 2, 1)}
    found = FoundFeatures(tuple(map(keys_of, pixels)), same, (sift, sift))
    try:
        made = registration.register(images, "ab", found, threshold=1.0, seed=0)
        return made.registered.all()
    except MatchingError as error:
        assert "too few to be sure" in str(error)
        return False


@pytest.mark.parametrize(
    ("count", "sift", "enough"),
    [(25, 25, True), (25, 20, True), (25, 0, False), (60, 0, True)],
)
def test_a_few_learned_matches_alone_place_nothing(surface, count, sift, enough):
    assert placed(*surface, count, sift) == enough


def test_learned_matches_that_agree_but_whose_depths_jump_are_not_believed(surface):
    """Shifted along their epipolar lines they agree as well as before, which is all that SIFT's are
    asked for.
    """
    images, (first, second) = surface
    rng = np.random.default_rng(5)
    k = images[0].K
    depths = rng.uniform(3, 8, (len(first), 1))
    jumping = project(ASIDE.apply(rays_through(first, k) * depths), k)
    assert placed(images, (first, second), 150, 0)
    assert placed(images, (first, jumping), 150, 150)
    assert not placed(images, (first, jumping), 150, 0)


@pytest.mark.slow
def test_learned_matches_place_what_wrong_ones_of_sift_would_hide(surface):
    images, (first, second) = surface
    broken = second.copy()
    broken[:270] = np.random.default_rng(7).uniform((0, 0), SIZE[::-1], (270, 2))
    assert not placed(images, (first, broken), 270, 270)
    broken[230:] = second[230:]
    assert placed(images, (first, broken), 300, 230)


@pytest.mark.slow
def test_learned_matches_that_agree_in_one_corner_only_are_not_believed(surface):
    images, (first, second) = surface
    corner = np.argsort(np.abs(first - (30, 30)).max(axis=1))
    first, second = first[corner], second[corner].copy()
    second[34:] = np.random.default_rng(6).uniform((0, 0), SIZE[::-1], (266, 2))
    assert not placed(images, (first, second), 300, 0)
    assert placed(images, (first, second), 34, 0)


def test_what_agrees_in_one_corner_of_both_pictures_only_is_a_poster(surface):
    """SIFT's matches of a poster are right, but say where the poster was and not where the
    camera.
    """
    images, (first, second) = surface
    rng = np.random.default_rng(9)
    on_it = (np.abs(first - np.median(first, axis=0)) < (45, 34)).all(axis=1)
    anywhere = rng.uniform((0, 0), SIZE[::-1], second.shape)
    apart = np.where(on_it[:, None], second, anywhere)
    chosen = np.concatenate((np.flatnonzero(on_it), np.flatnonzero(~on_it)[:60]))
    assert on_it.sum() > 20
    with pytest.raises(MatchingError, match="as on a poster"):
        keys = tuple(keys_of(points[chosen]) for points in (first, apart))
        found = FoundFeatures(keys, {(0, 1): np.stack([np.arange(len(chosen))] * 2, 1)})
        registration.register(images, "ab", found, threshold=1.0, seed=0)
    # the same thing before a plain wall, where nothing else is to be matched
    alone = np.flatnonzero(on_it)
    assert placed(images, (first[alone], second[alone]), len(alone), len(alone))


def test_a_pair_that_the_other_photos_contradict_is_refused(scene):
    """Half of the points look elsewhere in one pair, all by the same motion: wrong, but wrong
    together.
    """
    images, keypoints, matches, true = scene
    keys = list(map(keys_of, keypoints))
    turn = cv2.Rodrigues(np.array([0.0, 0.5, 0.0]))[0]
    wrong = Pose(turn, np.array([-1.0, 0.2, 0.1]))
    depths = np.random.default_rng(3).uniform(4, 8, (POINTS, 1))
    rays = rays_through(keypoints[0], images[0].K) * depths
    keys[2] = keys[2].followed_by(keys_of(project(wrong.apply(rays), images[0].K)))
    to_those = np.stack([np.arange(POINTS), POINTS + np.arange(POINTS)], 1)
    found = FoundFeatures(tuple(keys), matches | {(0, 2): to_those})
    pairs, failures = agreeing_pairs(images, found, 1.0, 0)
    assert set(failures) == {(0, 2)}
    assert "other photos" in failures[0, 2]
    assert len(pairs) == 5
    result = registration.register(images, "abcd", found, threshold=1.0, seed=0)
    assert result.registered.all()
    assert errors(dict(enumerate(result.poses)), true)[0] < 0.1
    assert (0, 2) not in result.pairs


@pytest.mark.parametrize("why", ["few", "contradicted"])
def test_two_views_without_a_motion_of_their_own_share_what_agrees_with_the_others_poses(
    scene, monkeypatch, why
):
    """Ten matches show no motion; right ones of a wall may show a wrong one, which takes right
    pairs down with it.
    """
    images, keypoints, matches, _ = scene
    if why == "few":
        matches = {**matches, (0, 3): matches[0, 3][:10]}
    found = FoundFeatures(tuple(map(keys_of, keypoints)), matches)
    own = agreeing_pairs

    def without_one(*args):
        pairs, failures = own(*args)
        return {pair: view for pair, view in pairs.items() if pair != (0, 3)}, failures

    monkeypatch.setattr(registration, "agreeing_pairs", without_one)
    result = registration.register(images, "abcd", found, threshold=1.0, seed=0)
    assert len(result.pairs[0, 3].matches) == (10 if why == "few" else POINTS)
    assert 0 in result.neighbours_of(3)
    assert np.median(result.pairs[0, 3].parallax) > 5


def test_registration_settles_its_poses_so(scene, monkeypatch):
    """Views placed one after the other are nearer to the truth when they are adjusted together,
    twice.
    """
    images, keypoints, matches, true = scene
    rng = np.random.default_rng(3)
    noisy = tuple(keys_of(p + rng.normal(0, 0.5, p.shape)) for p in keypoints)

    def off():
        given = images, "abcd", FoundFeatures(noisy, matches)
        found = registration.register(*given, threshold=1.0, seed=0)
        return errors(dict(enumerate(found.poses)), true)

    turn, step = off()
    monkeypatch.setattr(bundle_adjustment, "adjust", lambda *args: (args[3], 1.0))
    raw_turn, raw_step = off()
    assert turn < 0.8 * raw_turn and step < raw_step


def test_depth_is_measured_from_photos_at_a_moderate_angle_first(scene):
    """More matches a right angle away say less of depth than fewer from nearer by: surfaces look
    different there.
    """

    def pair(count, degrees):
        rays, indices = np.zeros((count, 3)), np.zeros((count, 2), int)
        matches = Matches(rays, rays, FOCAL, 0.01)
        return PairView(matches, indices, Pose.identity(), np.full(count, degrees))

    pairs = {(0, 1): pair(60, 70.0), (0, 2): pair(36, 25.0), (0, 3): pair(60, 0.5)}
    poses = tuple(scene[3].values())
    placed = registration.Registration(poses, np.ones(VIEWS, bool), pairs)
    assert placed.neighbours_of(0)[0] == 2
