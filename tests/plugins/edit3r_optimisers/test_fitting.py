"""A fit finds the scene and repeats itself; its schedule and its loss."""

import pytest
import torch
from edit3r_optimisers.fitting import (
    FitSettings,
    TargetImages,
    TrainableGaussians,
    differentiable_ssim,
    fit,
    photometric_loss,
    scene_extent,
    step_sizes,
    view_at,
)
from skimage.metrics import structural_similarity as reference

from edit3r.contract.types import Views
from edit3r_testing import gaussian_cloud

QUICK = FitSettings(seed=3)
FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


@pytest.fixture
def start(build, posed):
    """First Gaussians and cameras."""
    first = build("refit").reconstructor(posed)
    return first.gaussians, first.cameras


def fitted(start, posed, rasterizer, steps, settings=QUICK):
    targets = TargetImages(posed.images[0])
    return fit(*start, targets, rasterizer, settings, steps, "test")


def psnr(image, target) -> float:
    return float(-10 * torch.log10((image.clamp(0, 1) - target).square().mean()))


@pytest.mark.slow
def test_loss_falls_and_the_views_look_like_the_photos(start, posed, rasterizer):
    settings = FitSettings(colour_rate=0.05, seed=3)
    result = fitted(start, posed, rasterizer, 90, settings)
    first, last = (sum(part) / 9 for part in (result.losses[:9], result.losses[-9:]))
    assert last < first / 4
    rendering = rasterizer.render(result.gaussians, start[1])
    # the grey ones it began with: 16 dB
    assert psnr(rendering.images, posed.images) > 26
    assert psnr(rasterizer.render(*start).images, posed.images) < 17


def test_gaussians_are_valid_and_know_the_view_they_came_from(start, posed, rasterizer):
    scene = fitted(start, posed, rasterizer, 12).gaussians
    assert not any(getattr(scene, name).requires_grad for name in FIELDS)
    assert scene.count == start[0].count
    assert torch.equal(scene.view_index, start[0].view_index)
    norms = scene.quats.norm(dim=-1)
    assert torch.allclose(norms, torch.ones_like(norms), atol=1e-5)


def test_extent_is_how_far_the_cameras_are_from_the_scene_however_near_each_other(
    truth, start
):
    near = scene_extent(*start)
    apart = Views(truth.views.images, truth.views.intrinsics, c2w=truth.cameras.c2w)
    # balls and wall are 1.8 to 4 away, the cameras 0.2 from each other
    assert 2 < near < 4.5 and apart.count == 3


def test_centres_slow_down_log_linearly_in_units_of_the_scene():
    """The other groups keep their pace."""
    sizes = [step_sizes(FitSettings(), step, 11, extent=3.0) for step in (0, 5, 10)]
    centres = [own.pop("means") for own in sizes]
    assert centres == pytest.approx([4.8e-4, 4.8e-5, 4.8e-6])
    assert sizes[0] == sizes[1] == sizes[2]


def test_every_round_looks_at_every_view_once_in_its_own_order():
    rounds = [[view_at(7 * r + k, 7, seed=1) for k in range(7)] for r in range(4)]
    assert all(sorted(views) == list(range(7)) for views in rounds)
    assert len({tuple(views) for views in rounds}) > 1


@pytest.fixture(scope="module")
def pair():
    draw = {"generator": torch.Generator().manual_seed(0), "dtype": torch.float64}
    a = torch.rand(3, 24, 30, **draw)
    return a, (a + 0.2 * torch.randn(a.shape, **draw)).clamp(0, 1)


def test_ssim_agrees_with_scikit_image_on_whole_windows(pair):
    a, b = (picture.permute(1, 2, 0).numpy() for picture in pair)
    options = {"gaussian_weights": True, "sigma": 1.5, "full": True}
    options["use_sample_covariance"] = False
    maps = reference(a, b, channel_axis=2, data_range=1.0, **options)[1]
    inside = maps[5:-5, 5:-5].mean()
    assert float(differentiable_ssim(*pair)) == pytest.approx(inside, abs=1e-9)


def test_a_picture_equals_itself_and_the_loss_is_zero(pair):
    assert float(differentiable_ssim(pair[0], pair[0])) == pytest.approx(1, abs=1e-12)
    assert float(photometric_loss(pair[0], pair[0], 0.2)) == pytest.approx(0, abs=1e-12)


def test_weights_of_the_two_terms_are_those_of_the_paper(pair):
    l1, dssim = (pair[0] - pair[1]).abs().mean(), (1 - differentiable_ssim(*pair)) / 2
    assert torch.allclose(photometric_loss(*pair, 0.2), 0.8 * l1 + 0.2 * dssim)
    assert torch.equal(photometric_loss(*pair, 0), l1)


def test_gradient_agrees_with_finite_differences(pair):
    a, b = pair[0][:1, :12, :13].clone().requires_grad_(), pair[1][:1, :12, :13]
    assert torch.autograd.gradcheck(
        lambda picture: photometric_loss(picture, b, 0.2), a, atol=1e-7
    )


def test_a_picture_smaller_than_a_window_has_a_loss():
    assert photometric_loss(*torch.rand(2, 3, 4, 2), 0.2).isfinite()


SIZES = step_sizes(FitSettings(), 0, 10, 1.0)


def test_gaussians_survive_the_way_in_and_out():
    scene = gaussian_cloud(5, degree=0)
    back = TrainableGaussians(scene).gaussians()
    for name in FIELDS:
        same = torch.allclose(getattr(back, name), getattr(scene, name), atol=1e-6)
        assert same, name


def test_the_first_step_moves_each_kind_by_its_own_size():
    scene = TrainableGaussians(gaussian_cloud(6, degree=0))
    before = {name: value.detach().clone() for name, value in scene.parameters.items()}
    scene.step(sum(value.sum() for value in scene.parameters.values()), SIZES)
    for name, value in scene.parameters.items():
        moved = before[name] - value.detach()
        size = torch.full_like(moved, SIZES[name])
        assert torch.allclose(moved, size, rtol=1e-2, atol=1e-7), name
