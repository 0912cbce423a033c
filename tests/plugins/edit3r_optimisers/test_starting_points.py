"""Where fits begin."""

from dataclasses import replace

import pytest
import torch
from edit3r_optimisers.settings import MethodSettings
from edit3r_optimisers.starting_points import begin, moved_to, random_points, thinned

from edit3r.errors import InputError, MatchingError
from edit3r.geometry.cameras import project
from edit3r.interfaces import Reconstructor
from edit3r.reporting import Report, collecting
from edit3r.types import Cameras, Reconstruction


@pytest.fixture
def first(build, posed) -> Reconstruction:
    return build("refit").reconstructor(posed)


class Lost(Reconstructor):
    def __call__(self, views, source=None, request=None):
        raise MatchingError("nothing in common.")


def shrunk(first: Reconstruction, factor: float) -> Reconstruction:
    """The same reconstruction in another unit of length."""
    c2w = first.cameras.c2w.clone()
    c2w[:, :, :3, 3] *= factor
    scene = replace(first.gaussians, means=first.gaussians.means * factor, scales=first.gaussians.scales * factor)
    return Reconstruction(scene, replace(first.cameras, c2w=c2w))


def test_another_unit_of_length_is_undone_by_the_known_poses(first):
    small = shrunk(first, 0.2)
    back = moved_to(small.gaussians, small.cameras, first.cameras)
    assert torch.allclose(back.means, first.gaussians.means, atol=1e-4)
    assert torch.allclose(back.scales, first.gaussians.scales, atol=1e-5)


def test_gaussians_stay_on_their_pixels_however_wrong_the_predicted_poses_are(first):
    wrong = Cameras(first.cameras.c2w.flip(1), first.cameras.intrinsics, first.cameras.image_size)
    wrong = replace(wrong, c2w=torch.linalg.inv(wrong.c2w[:, :1]) @ wrong.c2w)
    moved = moved_to(first.gaussians, wrong, first.cameras)
    for view in range(3):
        own = first.gaussians.view_index == view
        before, _ = project(first.gaussians.means[0, own], wrong.intrinsics[0, view], wrong.c2w[0, view])
        after, _ = project(moved.means[0, own], first.cameras.intrinsics[0, view], first.cameras.c2w[0, view])
        assert torch.allclose(after, before, atol=1e-4)


def test_known_poses_are_used_and_the_frame_is_that_of_view_0(first, posed):
    turned = replace(posed, c2w=torch.linalg.inv(posed.c2w[:, 1:2]) @ posed.c2w)
    _, cameras = begin(turned, build_of(first), MethodSettings())
    assert torch.equal(cameras.c2w[0, 0], torch.eye(4))
    assert torch.allclose(cameras.c2w, posed.c2w, atol=1e-5)


def build_of(first: Reconstruction) -> Reconstructor:
    class Known(Reconstructor):
        def __call__(self, views, source=None, request=None):
            return first

    return Known()


def test_without_known_poses_those_of_the_reconstruction_count(first, truth):
    _, cameras = begin(truth.views, build_of(first), MethodSettings())
    assert torch.equal(cameras.c2w, first.cameras.c2w)


def test_photos_that_cannot_be_matched_begin_at_random_where_poses_are_known(posed, truth):
    report = Report()
    with collecting(report):
        gaussians, _ = begin(posed, Lost(), MethodSettings(points=50))
    assert gaussians.count == 50 and "nothing in common" in report.warnings[0]
    with pytest.raises(MatchingError):
        begin(truth.views, Lost(), MethodSettings())


def test_a_random_start_without_poses_is_an_error_that_names_the_way_out(truth):
    with pytest.raises(InputError, match="start=reconstructor"):
        begin(truth.views, Lost(), MethodSettings(start="random"))


def test_random_points_lie_before_their_view_and_carry_its_colour(posed, first):
    points = random_points(posed, first.cameras, 200, seed=1)
    for view in range(3):
        own = points.view_index == view
        places, z = project(points.means[0, own], first.cameras.intrinsics[0, view], first.cameras.c2w[0, view])
        assert own.any() and (z > 0).all() and ((places > 0) & (places < 1)).all()
        row, column = (places[:, 1] * 32).long(), (places[:, 0] * 40).long()
        colours = points.harmonics[0, own, 0] * 0.28209479 + 0.5
        assert torch.allclose(colours, posed.images[0, view, :, row, column].T, atol=1e-5)
    again = random_points(posed, first.cameras, 200, seed=1)
    assert torch.equal(points.means, again.means)
    assert not torch.equal(points.means, random_points(posed, first.cameras, 200, seed=2).means)


def test_thinned_gaussians_cover_as_much_as_before(first):
    few = thinned(first.gaussians, 100, seed=0)
    ratio = first.gaussians.count / 100
    assert few.count == 100 and thinned(first.gaussians, 10**6, 0) is first.gaussians
    widened = few.scales[0, :, 0] / first.gaussians.scales[0, :, 0].mean()
    assert float(widened.mean()) == pytest.approx(ratio**0.5, rel=0.1)


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_random_points_have_a_size(posed, first, count):
    assert (random_points(posed, first.cameras, count, seed=0).scales > 0).all()
