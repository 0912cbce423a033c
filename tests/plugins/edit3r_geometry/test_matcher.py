from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from edit3r_geometry import matchers
from edit3r_geometry.calibration import LensReading

import edit3r
from edit3r import Views
from edit3r.contract.errors import MatchingError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.photos.triples import rotation_degrees
from edit3r_testing import photograph

pytestmark = pytest.mark.slow


def within_share(depth, truth, tolerance=0.1):
    """Share of pixels of known truth (> 0) whose depth is right after one common scale, the median
    ratio.
    """
    known = truth > 0
    measured = known & (depth > 0)
    scale = np.median(truth[measured] / depth[measured])
    off = np.abs(depth * scale / np.where(known, truth, 1) - 1)
    return (measured & (off <= tolerance)).sum() / known.sum()


@pytest.fixture(scope="module")
def matcher():
    return edit3r.build("matcher", "classical")


@pytest.fixture(scope="module")
def quick():
    """Looks at less, for those whose claim is no exactness."""
    less = {"working_size": 96, "planes": 24, "detection_size": 320}
    return edit3r.build("matcher", "classical", **less)


@pytest.fixture(scope="module")
def thorough():
    """Finds enough features for photos from wide apart."""
    return edit3r.build("matcher", "classical", working_size=96, planes=24)


@pytest.fixture(scope="module")
def plain():
    """Gives up at once where photos cannot be placed."""
    return edit3r.build("matcher", "classical", tilted=False)


@pytest.fixture(scope="module")
def matched(matcher, pair):
    return matcher.match(pair.views)


def pose_errors(geometry, room, view):
    """Of rotation and of direction [degrees]."""
    found, true = geometry.c2w[0, view].numpy(), room.c2w[view]
    a, b = found[:3, 3], true[:3, 3]
    cosine = np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)
    turn = rotation_degrees(found[:3, :3], true[:3, :3])
    return turn, np.degrees(np.arccos(cosine))


def joined(views, dim=1, names=()):
    """Photos in one scene, or scenes in one batch."""
    images, lenses = (
        torch.cat([getattr(one, name) for one in views], dim)
        for name in ("images", "intrinsics")
    )
    return Views(images, lenses, names)


def test_pose_of_a_known_room_is_within_a_third_of_a_degree(matched, pair):
    rotation, direction = pose_errors(matched, pair, 1)
    assert rotation < 0.3
    assert direction < 3


def test_photos_in_another_light_are_not_matched_anew(matcher, pair, monkeypatch):
    first = matcher.match(pair.views)
    brighter = replace(pair.views, images=(1.3 * pair.views.images).clamp(max=1))
    monkeypatch.setattr(matchers, "find_features", None)
    again = matcher.match_corrected(pair.views, brighter)
    assert torch.equal(again.c2w, first.c2w)
    assert not torch.equal(again.depths, first.depths)  # measured in one light
    with pytest.raises(TypeError):
        matcher.match(brighter)


@pytest.mark.parametrize("view", [0, 1])
def test_depth_of_a_known_room_is_right_almost_everywhere(matched, pair, view):
    assert within_share(matched.depths[0, view].numpy(), pair.depths[view], 0.1) > 0.9


def test_poses_and_depths_share_one_unit_of_length(matched, pair):
    measured = matched.confidence[0, 0].numpy() > 0.5
    ratios = matched.depths[0, 0].numpy()[measured] / pair.depths[0][measured]
    of_depths = np.median(ratios)
    found, true = (np.linalg.norm(x[1, :3, 3]) for x in (matched.c2w[0], pair.c2w))
    of_poses = found / true
    assert of_depths == pytest.approx(of_poses, rel=0.03)


def test_measured_pixels_are_right_and_most_pixels_are_measured(matched, pair):
    sure = matched.confidence[0, 0].numpy() > 0.5
    assert sure.mean() > 0.6
    known = np.where(sure, pair.depths[0], 0)
    assert within_share(matched.depths[0, 0].numpy(), known, 0.05) > 0.97


def test_same_photos_give_the_same_bytes(matcher, matched, pair):
    again = matcher.match(pair.views)
    for name in ("c2w", "depths", "confidence"):
        assert torch.equal(getattr(again, name), getattr(matched, name)), name


def test_a_scene_does_not_depend_on_its_batch(matcher, matched, pair, make_room):
    other = make_room([(0,), (0.3, 0, -3)], seed=50).views
    geometry = matcher.match(joined([other, pair.views], dim=0))
    assert torch.equal(geometry.depths[1], matched.depths[0])
    assert torch.equal(geometry.c2w[1], matched.c2w[0])


def test_views_may_have_different_focal_lengths(matcher, make_room):
    room = make_room([(0,), (0.4, 0.05, -5)], focals=[0.9, 1.15])
    geometry = matcher.match(room.views)
    rotation, _ = pose_errors(geometry, room, 1)
    assert rotation < 0.4
    assert within_share(geometry.depths[0, 0].numpy(), room.depths[0], 0.1) > 0.85


def test_depth_comes_at_the_size_of_the_views_when_measured_smaller(make_room):
    room = make_room([(0,), (0.4, 0.05, -5)], size=(200, 260))
    geometry = edit3r.build("matcher", "classical", working_size=130).match(room.views)
    assert geometry.depths.shape[2:] == (200, 260)
    assert within_share(geometry.depths[0, 0].numpy(), room.depths[0], 0.1) > 0.85


def test_three_views_are_placed_in_one_scale(matcher, make_room):
    room = make_room([(0,), (0.35, 0.05, -4), (-0.3, -0.05, 3)])
    geometry = matcher.match(room.views)
    assert geometry.registered.all()
    found, true = (
        np.linalg.norm(x[1:, :3, 3], axis=1) for x in (geometry.c2w[0], room.c2w)
    )
    assert (found / true)[0] == pytest.approx((found / true)[1], rel=0.05)
    assert max(pose_errors(geometry, room, view)[0] for view in (1, 2)) < 0.4
    for found, true in zip(geometry.depths[0].numpy(), room.depths):
        assert within_share(found, true) > 0.85


def test_a_photo_of_another_scene_is_reported_not_registered(quick, pair, make_room):
    stranger = make_room([(0,)], seed=70).views
    views = joined([pair.views, stranger], names=("left", "right", "stranger"))
    with collecting(Report()) as report:
        geometry = quick.match(views)
    assert geometry.registered.tolist() == [[True, True, False]]
    assert (geometry.confidence[0, 2] == 0).all()
    assert any("stranger" in warning for warning in report.warnings)


def test_photos_of_two_scenes_raise_with_the_reason_and_advice(quick, make_room):
    views = [make_room([(0,)], seed=seed).views for seed in (0, 70)]
    said = r"a\.jpg and b\.jpg.*too few to be sure.*[Gg]ive photos of one"
    with pytest.raises(MatchingError, match=said):
        quick.match(joined(views, names=("a.jpg", "b.jpg")))


def test_photos_from_wide_apart_are_matched_again_as_seen_from_aside(
    plain, thorough, make_room
):
    wide_pair = make_room([(-1.956, 0, 52.5), (1.956, 0, -52.5)])
    with pytest.raises(MatchingError):
        plain.match(wide_pair.views)
    with collecting(Report()) as report:
        geometry = thorough.match(wide_pair.views)
    assert pose_errors(geometry, wide_pair, 1)[0] < 1
    assert "of tilted images too" in report.notes["matcher.matches"]


def test_photos_that_are_placed_are_not_matched_again(matcher, pair, monkeypatch):
    monkeypatch.setattr(matchers, "with_tilted", None)
    with collecting(Report()) as report:
        matcher.match(pair.views)
    assert "tilted" not in report.notes["matcher.matches"]


def test_photos_from_wide_apart_are_told_that_their_lens_is_unsure(thorough, make_room):
    views = make_room([(-1.956, 0, 52.5), (1.956, 0, -52.5)]).views
    with pytest.warns(UserWarning, match="Give --fov if you know it"):
        thorough.match(replace(views, assumed=(True, True)))


def test_a_second_try_that_places_fewer_photos_is_not_taken(
    quick, pair, make_room, monkeypatch
):
    views = joined([pair.views, make_room([(0,)], seed=70).views])

    def without_matches(found, *_):
        nothing = {two: indices[:0] for two, indices in found.indices.items()}
        return replace(found, indices=nothing, tilted=True)

    monkeypatch.setattr(matchers, "with_tilted", without_matches)
    assert quick.match(views).registered.tolist() == [[True, True, False]]


def test_photos_from_one_place_raise_because_depth_cannot_be_read(
    plain, make_room, pair
):
    with pytest.raises(MatchingError, match="parallax"):
        plain.match(make_room([(0,), (0, 0, 3)]).views)
    with pytest.raises(MatchingError):
        plain.match(pair.views.select([0, 0]))


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (8, 300)])
def test_tiny_photos_raise_with_the_size_that_is_needed(matcher, size):
    views = Views(torch.rand(1, 2, 3, *size), torch.eye(3).expand(1, 2, 3, 3))
    said = f"{size[1]} x {size[0]} pixels.*at least 32"
    with pytest.raises(MatchingError, match=said):
        matcher.match(views)


def test_one_photo_alone_raises(matcher, pair):
    with pytest.raises(MatchingError, match="at least two"):
        matcher.match(pair.views.select([0]))


def test_the_packaged_motorcycle_pair_has_its_true_depth(matcher):
    from skimage.data import stereo_motorcycle

    files, cameras = packaged_pair()
    views = edit3r.load_views(files, cameras=cameras, size=256)
    height, width = views.image_size
    geometry = matcher.match(views)
    disparity = stereo_motorcycle()[2]
    pixels = disparity.shape[1]
    intrinsics = views.intrinsics[0].numpy()
    disparity = cv2.resize(disparity, (width, height), interpolation=cv2.INTER_NEAREST)
    known = np.isfinite(disparity) & (disparity > 0)
    between = intrinsics[1, 0, 2] - intrinsics[0, 0, 2]
    motion = np.where(known, disparity, 1) / pixels + between
    truth = np.where(known, 1 / motion, 0)
    assert within_share(geometry.depths[0, 0].numpy(), truth, 0.1) > 0.85


@pytest.mark.parametrize(
    ("radial", "gain", "bent"),
    [(-0.1, 0.06, True), (-0.1, 0.04, False), (-0.02, 0.5, False)],
)
def test_a_lens_bends_where_that_is_strong_and_explains_what_is_off(
    matcher, monkeypatch, radial, gain, bent
):
    fit = "edit3r_geometry.bundle_adjustment.fit_distortion"
    monkeypatch.setattr(fit, lambda *given: (radial, gain))
    views = replace(photograph(3, (96, 128)).views, assumed=(True,) * 3)
    found = matcher.lens(views)
    assert (found is not None) == bent
    assert not bent or found.distortion[0] == radial


@pytest.mark.parametrize("alike", [None, (40.0, 80.0)])
def test_a_lens_that_no_pair_tells_is_not_bent_by_all_photos_together(
    plain, monkeypatch, alike
):
    asked = []

    def register(*given, free_focal):
        asked.append(free_focal)
        raise MatchingError("seen enough")

    monkeypatch.setattr(matchers, "register", register)
    monkeypatch.setattr(matchers, "calibrate", lambda *_: LensReading(60.0, alike))
    views = replace(photograph(3, (64, 80)).views, assumed=(True,) * 3)
    with pytest.raises(MatchingError, match="seen enough"):
        plain.match(views)
    assert set(asked) == {alike is None}
