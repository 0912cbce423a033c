import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from edit3r_geometry import depth_maps
from edit3r_geometry.cameras import CalibratedImage, Pose
from edit3r_geometry.completion import (
    confirmed,
    fill,
    main_plane,
    pull_forward,
    without_speckles,
)
from edit3r_geometry.depth_maps import (
    DepthSettings,
    _before_skies,
    _measured,
    _with_coarse,
    inverse_depth_range,
)
from edit3r_geometry.plane_sweep import (
    Neighbour,
    RawDepth,
    matching_cost,
    plane_inverse_depths,
)
from edit3r_geometry.registration import Registration
from edit3r_geometry.relative_pose import Matches
from edit3r_geometry.semi_global import (
    EDGE,
    JUMP,
    LEAST_JUMP,
    SMALL_STEP,
    _jump_costs,
    aggregate,
    best_plane,
)

SIZE = (48, 64)
INTRINSICS = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
# the neighbour stands half a unit to the right
SIDEWAYS = Pose(np.eye(3), np.array([-0.5, 0, 0]))


@pytest.fixture
def noise():
    return np.random.default_rng(0).random((*SIZE, 3)).astype(np.float32)


def raw(inverse, step=0.01):
    inverse = np.broadcast_to(np.float32(inverse), SIZE).copy()
    return RawDepth(inverse, float(inverse.min()) - 5 * step, step)


def neighbour(image):
    return Neighbour(CalibratedImage(image, INTRINSICS), SIDEWAYS)


def reference_paths(cost, jump):
    """The eight paths as the paper writes them, pixel by pixel."""
    height, width = cost.shape[:2]
    total = np.zeros_like(cost)
    for dy, dx in itertools.product((-1, 0, 1), repeat=2):
        if dy == dx == 0:
            continue
        path = np.zeros_like(cost)
        ys = range(height) if dy >= 0 else range(height - 1, -1, -1)
        xs = range(width) if dx >= 0 else range(width - 1, -1, -1)
        for y, x in itertools.product(ys, xs):
            py, px = y - dy, x - dx
            path[y, x] = cost[y, x]
            if 0 <= py < height and 0 <= px < width:
                before, least = path[py, px], path[py, px].min()
                limit = least + min(jump[y, x], jump[py, px])
                padded = np.pad(before, 1, constant_values=np.inf)
                step = np.minimum(padded[:-2], padded[2:]) + SMALL_STEP
                path[y, x] += np.minimum(np.minimum(before, step), limit) - least
        total += path
    return total


def test_aggregation_is_the_sum_of_eight_paths():
    random = np.random.default_rng(0)
    cost, grey = (
        random.random(size).astype(np.float32) for size in ((9, 11, 7), (9, 11))
    )
    expected = reference_paths(cost.astype(float), _jump_costs(grey))
    assert np.allclose(aggregate(cost, grey), expected, atol=1e-4)


def test_best_plane_is_exact_on_a_parabola():
    planes = np.arange(9)
    total = ((planes - 3.3) ** 2)[None, None].astype(np.float32)
    assert best_plane(total)[0, 0] == pytest.approx(3.3, abs=1e-4)


@pytest.mark.parametrize(("gain", "share"), [(1, 0.99), (0.6, 0.95)])
def test_cost_is_least_at_the_true_plane_whatever_the_brightness(noise, gain, share):
    shift = 6  # pixels: inverse depth shift / (focal * baseline)
    beside = [neighbour(gain * np.roll(noise, -shift, axis=1))]
    inverse_depths = np.linspace(0.1, 0.3, 21)
    cost = matching_cost(CalibratedImage(noise, INTRINSICS), beside, inverse_depths)
    assert cost.shape == (*SIZE, 21)
    found = inverse_depths[cost[5:-5, 20:-5].argmin(axis=2)]
    assert (np.abs(found - shift / (60 * 0.5)) < 0.006).mean() > share


def test_what_one_neighbour_does_not_see_costs_a_third_beside_one_and_nothing_beside_two(
    noise,
):
    inverse_depths = np.linspace(0.1, 0.3, 21)
    clear = neighbour(np.roll(noise, -6, axis=1))
    hidden = neighbour(np.random.default_rng(1).random((*SIZE, 3)).astype(np.float32))
    picture = CalibratedImage(noise, INTRINSICS)
    inner = np.s_[5:-5, 20:-5, 10]  # at the true plane, 0.2
    assert np.abs(inverse_depths[10] - 0.2) < 1e-9
    seen, unseen, beside_one, beside_two = (
        matching_cost(picture, around, inverse_depths)[inner]
        for around in ([clear], [hidden], [clear, hidden], [clear, hidden, clear])
    )
    assert np.allclose(beside_one, (2 * seen + unseen) / 3, atol=1e-5)
    assert np.allclose(beside_two, seen, atol=1e-5)


@pytest.mark.parametrize(
    ("matches", "wide", "third", "measured_by"),
    [
        (80, 0.5, 1, 2),
        (80, 0.2, 1, 1),
        (40, 0.5, 1, 1),
        (40, 0.5, 20, 2),
        (80, 0.5, 20, 2),
    ],
    ids=["all over", "in a part", "few", "a fifth as useful", "beside two"],
)
def test_a_photo_that_shares_little_confirms_depths_and_measures_none(
    monkeypatch, noise, matches, wide, third, measured_by
):
    """A tenth as useful as the best one it measures with many matches all over, beside that one
    alone.
    """
    images = [CalibratedImage(noise, INTRINSICS)] * 4

    def pair(usefulness, count, width):
        rays = np.random.default_rng(0).uniform(-1, 1, (count, 3)) * width
        shared = Matches(rays, rays, 60.0, 0.01)
        return SimpleNamespace(usefulness=usefulness, matches=shared)

    pairs = {
        (0, 1): pair(100.0, 400, 0.5),
        (0, 2): pair(10.0, matches, wide),
        (0, 3): pair(third, 9, 0.5),
    }
    registration = Registration((Pose.identity(),) * 4, np.ones(4, bool), pairs)
    monkeypatch.setattr(Registration, "shared_depths", lambda *_: np.ones(9))
    swept, asked = [], []

    def confirm(*_):
        asked.append(1)
        return np.ones(SIZE, bool)

    def sweep(reference, neighbours, *_):
        swept.append(len(neighbours))
        return raw(0.1)

    monkeypatch.setattr(depth_maps, "sweep_depth", sweep)
    monkeypatch.setattr(depth_maps, "confirmed", confirm)
    depth_maps._swept(images, registration, DepthSettings())
    assert len(asked) == 3 + 1 + 1 + 1
    assert swept == [measured_by, 1, 1, 1]


def test_planes_are_a_pixel_apart(noise):
    picture = CalibratedImage(noise, INTRINSICS)
    planes = plane_inverse_depths(picture, [neighbour(noise)], (0.1, 1.5), 128)
    assert np.allclose(np.diff(planes) * 60 * 0.5, 1, atol=0.05)
    assert len(plane_inverse_depths(picture, [neighbour(noise)], (0.1, 9.0), 64)) == 64


def test_range_holds_the_points_with_room_before_them():
    depths = np.linspace(2, 4, 200)
    least, greatest = inverse_depth_range(depths)
    assert 0 < least < 1 / 4 and greatest > 1 / 2
    # a quarter of the span, and .1 and .15 of its ends, without the outer 2 %
    low, high = np.percentile(1 / depths, [2, 98])
    room = (high - low) / 4
    assert least == pytest.approx(0.9 * low - room)
    assert greatest == pytest.approx(1.15 * high + room)


def test_something_near_with_few_features_is_searched_for():
    """Four of 200 points lie at half the depth: not chance, and beyond what the others tell."""
    far = np.linspace(2, 4, 200)
    near, wrong = (np.r_[far, np.ones(count)] for count in (4, 3))
    assert inverse_depth_range(near)[1] > 1.1
    assert inverse_depth_range(wrong)[1] < 0.8
    # of two neighbours each tells its own points
    assert inverse_depth_range(near, 8)[1] < 0.8
    assert inverse_depth_range(np.r_[far, np.full(4, 0.01)])[1] < 3


def test_a_neighbour_confirms_its_own_surface_but_nothing_hidden_or_floating(noise):
    picture, beside = CalibratedImage(noise, INTRINSICS), neighbour(noise)
    same, behind, before = (
        confirmed(raw(own).inverse, picture, beside, raw(0.2))
        for own in (0.2, 0.1, 0.4)
    )
    assert same[:, 20:].all()
    assert not behind.any() and not before.any()
    assert not same[:, :5].any()  # outside the neighbour's image


def test_one_neighbour_that_confirms_is_enough(noise):
    picture = CalibratedImage(noise, INTRINSICS)
    around = {1: neighbour(noise), 2: neighbour(noise)}
    depths = {0: raw(0.2), 1: raw(0.2), 2: raw(0.1)}
    assert _measured(picture, around, 0, depths)[:, 20:].all()


def test_a_neighbour_confirms_nothing_behind_its_camera(noise):
    """It stands 110 units ahead of a surface at 10: both inverse depths are near 0, and alike."""
    ahead = Pose(np.eye(3), np.array([0, 0, -110.0]))
    beside = Neighbour(CalibratedImage(noise, INTRINSICS), ahead)
    picture = CalibratedImage(noise, INTRINSICS)
    assert not confirmed(raw(0.1).inverse, picture, beside, raw(0.001)).any()


def test_what_only_the_coarse_sweep_measured_is_taken_and_nothing_else_changes():
    fine, coarse = raw(0.5), replace(raw(0.2), inverse=np.full((24, 32), 0.2, "f4"))
    measured, there = np.zeros(SIZE, bool), np.zeros((24, 32), bool)
    measured[:, :20], there[:12] = True, True
    both, known = _with_coarse(fine, measured, coarse, there)
    assert (known == (measured | (np.arange(48) < 24)[:, None])).all()
    assert (both.inverse == np.where(known & ~measured, np.float32(0.2), 0.5)).all()
    assert (both.step, both.farthest) == (fine.step, fine.farthest)


def test_lone_agreements_are_taken_out():
    agrees = np.zeros(SIZE, bool)
    agrees[10:30, 10:30] = True
    agrees[40, 50] = True
    agrees[35:37, 5:7] = True
    kept = without_speckles(agrees, raw(0.2))
    assert kept[11:29, 11:29].all()
    assert kept[10:30, 10:30].sum() == kept.sum()


def test_filling_continues_a_plane():
    x = np.arange(SIZE[1], dtype=np.float32)
    inverse = np.broadcast_to(0.1 + 0.002 * x, SIZE).astype(np.float32).copy()
    measured = np.ones(SIZE, bool)
    measured[:, 20:32] = False
    wrong = np.where(measured, inverse, np.float32(0.9))
    filled = fill(wrong, measured, 0.01, np.full((*SIZE, 3), 0.5, np.float32))
    assert np.abs(filled - inverse).max() < 0.01  # a step between hypotheses


def test_filling_keeps_what_lies_beside_a_gap():
    inverse = np.full(SIZE, 0.30, np.float32)
    inverse[:, 32:] = 0.28  # a small step, which the picture does not show
    measured = np.ones(SIZE, bool)
    measured[:, 26:32] = False
    wrong = np.where(measured, inverse, np.float32(0.9))
    filled = fill(wrong, measured, 0.005, np.full((*SIZE, 3), 0.5, np.float32))
    np.testing.assert_allclose(filled[:, 26:29], 0.30, atol=1e-4)
    np.testing.assert_allclose(filled[:, 29:32], 0.28, atol=1e-4)


def test_a_near_surface_does_not_grow_over_what_goes_on_behind_it():
    image = np.ones((*SIZE, 3), np.float32)
    image[:, 16:28] = 0
    inverse = np.where(image[..., 0] > 0, np.float32(0.1), np.float32(0.4))
    measured = np.ones(SIZE, bool)
    # only one photo shows it: for the other the near surface hides it
    measured[:, 28:34] = False
    filled = fill(np.where(measured, inverse, np.float32(0.25)), measured, 0.01, image)
    assert filled[:, 28:34].max() < 0.11


def test_filling_stops_at_edges_of_the_picture():
    image = np.zeros((*SIZE, 3), np.float32)
    image[:, 48:] = 1
    inverse = np.where(image[..., 0] > 0, np.float32(0.4), np.float32(0.1))
    measured = np.ones(SIZE, bool)
    measured[:, 42:54] = False
    filled = fill(np.where(measured, inverse, np.float32(0.25)), measured, 0.01, image)
    assert np.abs(filled - inverse).max() < 0.03


def test_main_plane_ignores_a_smaller_second_surface():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    plane = 0.1 + 0.001 * x + 0.002 * y
    inverse = plane.copy()
    inverse[10:25, 10:25] = 0.9
    found, limits = main_plane(inverse, np.ones(SIZE, bool))
    assert np.abs(found - plane).max() < 0.003
    assert limits[0] >= inverse.min() and limits[1] <= inverse.max()


def test_what_hides_another_s_sky_is_moved_until_the_others_look_past_it(noise):
    picture, beside = CalibratedImage(noise, INTRINSICS), neighbour(noise)
    guess = np.full(SIZE, 0.1, np.float32)
    guessed = np.zeros(SIZE, bool)
    guessed[:20, 30:40] = True
    shown = np.full(SIZE, 0.1, np.float32)
    shown[:30] = 0
    shown[:, :10] = 0.1  # a wall, which is not to be hidden either
    moved = pull_forward(guess, guessed, picture, [(beside, shown)])
    assert (moved[~guessed] == 0.1).all()
    # A point leaves the neighbour's image on the left: x - 60 * 0.5 * inverse depth < 0.
    x = np.arange(30, 40) + 0.5
    assert (moved[:20, 30:40] > 3 * x / 30 - 1e-5).all()
    assert (moved[:20, 30:40] < 3 * 1.11 * x / 30).all()


@pytest.mark.parametrize("shown", [0.1, -1.0])
def test_a_guess_that_hides_no_sky_stays(noise, shown):
    picture, beside = CalibratedImage(noise, INTRINSICS), neighbour(noise)
    guess = np.full(SIZE, 0.2, np.float32)
    other = np.full(SIZE, shown, np.float32)
    moved = pull_forward(guess, np.ones(SIZE, bool), picture, [(beside, other)])
    assert (moved == guess).all()


def test_a_guess_stays_where_no_place_hides_nothing(noise):
    """From the same place, the other photo sees the sky along the whole ray."""
    picture = CalibratedImage(noise, INTRINSICS)
    same = Neighbour(picture, Pose(np.eye(3), np.zeros(3)))
    guess = np.full(SIZE, 0.2, np.float32)
    sky = np.zeros(SIZE, np.float32)
    moved = pull_forward(guess, np.ones(SIZE, bool), picture, [(same, sky)])
    assert (moved == guess).all()


def test_only_guesses_that_look_like_no_sky_are_moved_before_it():
    """A branch, clouds and a measured roof, before the neighbour's sky."""
    image = np.full((*SIZE, 3), (0.4, 0.6, 0.9), np.float32)
    branch, roof = np.zeros(SIZE, bool), np.zeros(SIZE, bool)
    branch[:10, 30:40] = True
    roof[20:30, 30:40] = True
    image[branch | roof] = 0.1
    image[:10, 10:20] = (1.0, 0.8, 0.3)  # a cloud in the evening, found by its place
    sky = ~branch & ~roof
    sky[:, 45:50] = False  # a pale cloud that was not found
    ways = {"neighbours_of": lambda view: [1], "relative": lambda *views: SIDEWAYS}
    images = [CalibratedImage(image, INTRINSICS)] * 2
    depths, measured = dict.fromkeys((0, 1), raw(0.1)), {0: roof, 1: roof & False}
    given = images, SimpleNamespace(**ways), depths, measured
    guess = np.full(SIZE, 0.1, np.float32)
    moved = _before_skies(guess, 0, *given, [sky, np.ones(SIZE, bool)])
    assert (moved[branch] > 1).all()
    assert (moved[~branch] == np.float32(0.1)).all()


def test_a_jump_of_depth_costs_less_where_the_picture_has_an_edge():
    grey = np.zeros((9, 12), np.float32)
    grey[:, 6:] = 0.3
    costs = _jump_costs(grey)
    flat, edge = costs[4, 2], costs[4, 5:7]
    assert np.allclose(flat, LEAST_JUMP + JUMP)
    assert np.allclose(edge, LEAST_JUMP + JUMP * np.exp(-0.3 / EDGE))
    assert np.allclose(_jump_costs(grey.T), costs.T)
