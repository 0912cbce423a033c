"""Where fits begin."""

import pytest
import torch
from edit3r_optimisers.starting_points import VISIBLE_OPACITY, begin, thinned

from edit3r.types import Reconstruction


@pytest.fixture
def first(build, posed) -> Reconstruction:
    return build("refit").reconstructor(posed)


def test_a_fit_begins_with_visible_gaussians_and_the_cameras_of_the_reconstruction(build, posed, first):
    gaussians, cameras = begin(posed, build("refit").reconstructor, 100, seed=0)
    assert torch.equal(cameras.c2w, first.cameras.c2w)
    assert gaussians.count == 100 and gaussians.opacities.min() >= VISIBLE_OPACITY


def test_thinned_gaussians_cover_as_much_as_before(first):
    few = thinned(first.gaussians, 100, seed=0)
    ratio = first.gaussians.count / 100
    assert few.count == 100 and thinned(first.gaussians, 10**6, 0) is first.gaussians
    widened = few.scales[0, :, 0] / first.gaussians.scales[0, :, 0].mean()
    assert float(widened.mean()) == pytest.approx(ratio**0.5, rel=0.1)
