"""Where fits begin."""

from dataclasses import replace

import pytest
import torch
from edit3r_optimisers.starting_points import VISIBLE_OPACITY, begin, thinned

from edit3r.types import Reconstruction


@pytest.fixture
def first(build, posed) -> Reconstruction:
    return build("refit").reconstructor(posed)


def test_known_poses_are_used_and_the_frame_is_that_of_view_0(build, posed):
    turned = replace(posed, c2w=torch.linalg.inv(posed.c2w[:, 1:2]) @ posed.c2w)
    gaussians, cameras = begin(turned, build("refit").reconstructor, 100, seed=0)
    assert torch.allclose(cameras.c2w, posed.c2w, atol=1e-5)
    assert gaussians.count == 100 and gaussians.opacities.min() >= VISIBLE_OPACITY


def test_thinned_gaussians_cover_as_much_as_before(first):
    few = thinned(first.gaussians, 100, seed=0)
    ratio = first.gaussians.count / 100
    assert few.count == 100 and thinned(first.gaussians, 10**6, 0) is first.gaussians
    widened = few.scales[0, :, 0] / first.gaussians.scales[0, :, 0].mean()
    assert float(widened.mean()) == pytest.approx(ratio**0.5, rel=0.1)
