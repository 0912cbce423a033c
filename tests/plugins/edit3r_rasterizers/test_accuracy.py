"""Every rasterizer that runs here against an independent float64 renderer, and their gradients
against each other.
"""

import pytest
import torch
from raster_scenes import (
    FIELDS,
    assert_matches_naive,
    cameras,
    cloud,
    gradients,
    one,
)

import edit3r


@pytest.fixture(params=["torch", "numba"])
def rasterizer(request):
    return edit3r.build("rasterizer", request.param)


@pytest.fixture(scope="module")
def numba():
    return edit3r.build("rasterizer", "numba")


@pytest.fixture(scope="module")
def reference():
    return edit3r.build("rasterizer", "torch")


@pytest.mark.parametrize("degree", range(5))
def test_pictures_agree_with_the_naive_renderer(rasterizer, degree):
    scene, views = cloud(80, degree), cameras(count=2)
    assert_matches_naive(rasterizer.render(scene, views), scene, views)


def test_small_splats_agree_with_the_naive_renderer(rasterizer):
    scene, views = cloud(300, scales=(0.003, 0.03)), cameras((64, 48))
    assert_matches_naive(rasterizer.render(scene, views), scene, views)


def test_batches_render_each_scene_with_its_own_cameras(rasterizer):
    scene, views = cloud(30, batch=3), cameras((20, 31), count=2, batch=3)
    assert_matches_naive(rasterizer.render(scene, views), scene, views)


def test_settings_change_the_picture_as_they_say(rasterizer):
    changed = {"near_plane": 2.8, "far_plane": 3.4, "eps2d": 1.0, "max_alpha": 0.7}
    changed["background"] = (0.2, 0.5, 0.9)
    scene, views = cloud(60), cameras()
    other = edit3r.build("rasterizer", rasterizer.offer.component.name, **changed)
    assert_matches_naive(other.render(scene, views), scene, views, **changed)


def test_off_centre_and_anisotropic_intrinsics(rasterizer):
    scene, views = cloud(60), cameras()
    views.intrinsics[..., 0, 2] = 0.3
    views.intrinsics[..., 1, 2] = 0.8
    views.intrinsics[..., 1, 1] *= 0.6
    assert_matches_naive(rasterizer.render(scene, views), scene, views)


def test_a_pixel_ends_before_the_gaussian_that_would_take_it_below_the_least_transmittance(
    rasterizer,
):
    # Three layers leave 0.07^3 = 3.4e-4, a fourth would leave 2.4e-5: it and all behind it are not
    # drawn.
    layers = [
        one(means=[0.0, 0.0, 2.0 + k], scales=[99.0, 99.0, 0.1], opacities=0.93)
        for k in range(6)
    ]
    rendering = rasterizer.render(edit3r.Gaussians.cat(layers), cameras((1, 1)))
    assert rendering.alphas.item() == pytest.approx(1 - 0.07**3, abs=1e-6)
    depth = 0.93 * (2 + 3 * 0.07 + 4 * 0.07**2) / (1 - 0.07**3)
    assert rendering.depths.item() == pytest.approx(depth, rel=1e-5)


def test_mean_of_a_distant_wide_picture_is_placed_to_a_thousandth_of_a_pixel(numba):
    scene = one(means=[0.9, 0.1, 2.0], scales=[1e-5] * 3)
    views = cameras((8, 4000), fov=1.2)
    assert_matches_naive(numba.render(scene, views), scene, views)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_numba_gradients_agree_with_the_reference(numba, reference, degree):
    background = torch.tensor([0.2, 0.5, 0.8])
    scene, views = cloud(120, degree, batch=2), cameras((33, 47), count=2, batch=2)
    found = gradients(numba, scene, views, background)
    truth = gradients(
        reference, scene.to(torch.float64), views.to(torch.float64), background
    )
    for name, gradient in truth.items():
        allowed = 1e-3 * gradient.abs() + 1e-4 * gradient.abs().max()
        assert ((found[name] - gradient).abs() <= allowed).all(), name


@pytest.mark.parametrize("x, y", [(2.4, 0.1), (-2.4, 0.1), (0.1, 2.0), (0.1, -2.0)])
def test_gradients_of_a_gaussian_beyond_one_border_only(numba, reference, x, y):
    """There one tangent of the Jacobian is clamped, and the other one still moves it."""
    scene = one(means=[x, y, 2.0], scales=[0.9, 0.5, 0.7], quats=[0.9, 0.2, 0.3, 0.1])
    assert_gradients_agree(numba, reference, scene)


def test_no_gradient_passes_the_cap_of_alpha(numba, reference):
    """In its middle alpha is held at the cap, whatever opacity and shape are."""
    scene = one(opacities=1.0, scales=[0.4, 0.2, 0.3], quats=[0.9, 0.2, 0.3, 0.1])
    assert_gradients_agree(numba, reference, scene)


def assert_gradients_agree(numba, reference, scene) -> None:
    background, views = torch.tensor([0.2, 0.5, 0.8]), cameras((33, 47))
    exact = scene.to(torch.float64), views.to(torch.float64)
    truth = gradients(reference, *exact, background)
    found = gradients(numba, scene, views, background)
    assert truth["means"].abs().max() > 0
    for name, gradient in truth.items():
        assert (found[name] - gradient).abs().max() <= 1e-3 * gradient.abs().max(), name


@pytest.mark.slow
def test_reference_gradients_agree_with_finite_differences(reference):
    scene = cloud(3, degree=1, dtype=torch.float64)
    views = cameras((3, 4), dtype=torch.float64)
    background = torch.tensor([0.2, 0.5, 0.8], dtype=torch.float64)

    def render(background, *fields):
        rendering = reference.render(edit3r.Gaussians(*fields), views, background)
        return rendering.images, rendering.alphas, rendering.depths

    inputs = [background, *(getattr(scene, name) for name in FIELDS)]
    leaves = [value.requires_grad_() for value in inputs]
    assert torch.autograd.gradcheck(render, leaves, atol=1e-5)


def test_reference_chunks_change_nothing(reference, monkeypatch):
    scene = cloud(200, dtype=torch.float64)
    views = cameras((20, 20), dtype=torch.float64)
    whole = reference.render(scene, views).images
    monkeypatch.setattr("edit3r_rasterizers.torch_rasterizer.CHUNK", 7)
    assert torch.allclose(reference.render(scene, views).images, whole, atol=1e-12)


def test_reference_keeps_dtype_and_numba_gives_float64_back(rasterizer):
    scene, views = cloud(10, dtype=torch.float64), cameras((9, 9), dtype=torch.float64)
    assert rasterizer.render(scene, views).images.dtype == torch.float64


def test_background_per_camera_and_its_gradient(rasterizer):
    scene, views = cloud(20, batch=2), cameras((9, 12), count=3, batch=2)
    background = torch.rand(2, 3, 3).requires_grad_()
    rendering = rasterizer.render(scene, views, background)
    rendering.images.sum().backward()
    left = (1 - rendering.alphas).sum((-1, -2)).expand(2, 3, 3)
    assert torch.allclose(background.grad, left, rtol=1e-4, atol=1e-4)


def test_contributions_are_alpha_in_sum_and_several_maps_give_what_each_gives(
    rasterizer,
):
    scene = cloud(30)
    views = cameras((40, 56), 2)
    alone = rasterizer.contributions(scene, views)
    alphas = rasterizer.render(scene, views).alphas
    assert alone.shape == (1, 30)
    assert torch.allclose(alone.sum(), alphas.sum(), rtol=1e-4)
    left = torch.zeros(2, *views.image_size)
    left[..., : views.image_size[1] // 2] = 1
    both = rasterizer.contributions(scene, views, torch.stack((left, 1 - left), 1))
    for index, weights in enumerate((left, 1 - left)):
        expected = rasterizer.contributions(scene, views, weights)
        assert torch.equal(both[..., index], expected)
    assert torch.allclose(both.sum(-1), alone, rtol=1e-3, atol=1e-4)
