"""Flat things become few Gaussians, detail stays, and the pictures hardly change."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_refiners.settings import SimplifySettings
from edit3r_refiners.simplify import agreement, simplify

from edit3r.contract.types import Gaussians
from edit3r.kit.compute.metrics import psnr
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r_testing.scenes import cameras_around, gaussian_cloud, photograph

from .scenes import flat_wall, gaussian_per_pixel, textured

FIELDS = ("means", "scales", "quats", "opacities", "harmonics", "view_index")


def pictures(rasterizer, gaussians, cameras) -> np.ndarray:
    with torch.no_grad():
        return rasterizer.render(gaussians, cameras).images.clamp(0, 1).numpy()


@pytest.mark.parametrize("views", [1, 2])
def test_a_flat_wall_keeps_under_two_percent_of_its_gaussians_and_its_colour(
    rasterizer, views
):
    gaussians, cameras = flat_wall(views)
    result = simplify(gaussians, cameras, rasterizer)
    assert result.gaussians.count < 0.02 * gaussians.count
    middle = pictures(rasterizer, result.gaussians, cameras)[..., 8:-8, 8:-8]
    assert np.abs(middle - 0.6).mean() < 0.03


def test_merged_gaussians_have_the_mean_of_their_uncertainty(rasterizer):
    gaussians, cameras = flat_wall()
    number = torch.linspace(0.2, 0.6, gaussians.count)[None]
    gaussians = replace(gaussians, uncertainty=number)
    result = simplify(gaussians, cameras, rasterizer).gaussians
    assert result.uncertainty.shape == (1, result.count)
    weighed = result.uncertainty * result.scales.amax(-1).square()
    mean = weighed.sum() / result.scales.amax(-1).square().sum()
    assert result.uncertainty.min() > 0.19 and result.uncertainty.max() < 0.61
    assert mean == pytest.approx(0.4, abs=0.03)


def test_detail_survives_on_a_flat_wall(rasterizer):
    gaussians, cameras = flat_wall()
    detail = torch.zeros(64, 64, dtype=torch.bool)
    detail[20:36, 20:36] = (torch.arange(16)[:, None] + torch.arange(16)) % 2 == 0
    gaussians.harmonics[:, detail.flatten()] = colour_to_dc(
        torch.tensor([0.1, 0.2, 0.9])
    )
    before = pictures(rasterizer, gaussians, cameras)[0, 0, :, 20:36, 20:36]
    result = simplify(gaussians, cameras, rasterizer)
    after = pictures(rasterizer, result.gaussians, cameras)[0, 0, :, 20:36, 20:36]
    assert 256 * 0.9 < result.gaussians.count < 0.15 * gaussians.count
    assert psnr(after, before) > 18


def test_a_textured_scene_loses_two_thirds_and_little_else(rasterizer):
    gaussians, cameras, photos = textured(size=(96, 128))
    result = simplify(gaussians, cameras, rasterizer)
    assert result.gaussians.count < gaussians.count / 3
    before, after = (
        pictures(rasterizer, g, cameras) for g in (gaussians, result.gaussians)
    )
    alike = agreement(gaussians, result.gaussians, cameras, rasterizer)
    assert alike == pytest.approx(psnr(after, before), abs=1e-3)
    assert psnr(after, photos.numpy()) > psnr(before, photos.numpy()) - 1


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_new_view_between_the_inputs_loses_under_a_fifth_of_a_decibel(
    rasterizer, seed
):
    scene = photograph(3, (96, 128), seed=seed)
    inputs, between = scene.cameras.select([0, 2]), scene.cameras.select([1])
    gaussians = gaussian_per_pixel(
        scene.views.images[0, [0, 2]], scene.depths[0, [0, 2]], inputs
    )
    fewer = simplify(gaussians, inputs, rasterizer).gaussians
    assert fewer.count < gaussians.count / 3
    photo = scene.views.images[:, [1]].numpy()
    before, after = (
        psnr(pictures(rasterizer, g, between), photo) for g in (gaussians, fewer)
    )
    assert after > before - 0.2


@pytest.mark.parametrize("most", [1, 40, 500, 3000])
def test_a_budget_is_met_and_used(rasterizer, most):
    gaussians, cameras, _ = textured()
    count = simplify(gaussians, cameras, rasterizer, most).gaussians.count
    assert 0.9 * most <= count <= most


def test_a_budget_above_the_number_there_is_changes_nothing(rasterizer):
    gaussians, cameras = flat_wall(size=8)
    result = simplify(gaussians, cameras, rasterizer, 64)
    assert result.gaussians is gaussians


def test_every_gaussian_is_accounted_for(rasterizer):
    gaussians, cameras, _ = textured()
    result = simplify(gaussians, cameras, rasterizer)
    assert result.before == gaussians.count
    gone = result.unseen + result.doubled + result.merged
    assert result.before - gone == result.gaussians.count
    assert min(result.doubled, result.merged) > 0


def test_hidden_gaussians_go(rasterizer):
    gaussians, cameras = flat_wall(size=32)
    means, scales = gaussians.means, gaussians.scales
    hidden = replace(gaussians, means=means * 2, scales=scales * 0.5)
    behind = replace(hidden, harmonics=colour_to_dc(torch.rand(1, 1024, 1, 3)))
    solid = torch.ones_like(gaussians.opacities)
    opaque = replace(gaussians, opacities=solid, scales=scales * 2)
    result = simplify(Gaussians.cat((opaque, behind)), cameras, rasterizer)
    assert result.unseen >= 1000


def test_gaussians_of_no_view_and_any_shape_are_kept_finite(rasterizer):
    gaussians, cameras = gaussian_cloud(300, degree=2), cameras_around(3)
    result = simplify(gaussians, cameras, rasterizer)
    assert all(torch.isfinite(getattr(result.gaussians, name)).all() for name in FIELDS)
    assert 0 < result.gaussians.count <= 300
    assert (result.gaussians.view_index == -1).all()


def test_no_gaussian_and_none_that_a_camera_sees_leave_none(rasterizer):
    gaussians, cameras = flat_wall(size=8)
    empty = gaussians.select(torch.zeros(0, dtype=torch.long))
    for scene in (empty, replace(gaussians, means=-gaussians.means)):
        assert simplify(scene, cameras, rasterizer).gaussians.count == 0


def test_depth_edges_stay_apart_seen_from_the_side(rasterizer, monkeypatch):
    """A near square over a far wall of the same colour: no merged Gaussian lies between them."""
    _, cameras = flat_wall(views=2)
    depths = torch.full((2, 64, 64), 4.0)
    depths[:, 20:44, 20:44] = 2.0
    gaussians = gaussian_per_pixel(torch.full((2, 3, 64, 64), 0.6), depths, cameras)
    monkeypatch.setattr("edit3r_refiners.merging.BEHIND", 0)
    settings = SimplifySettings(polish=0)
    result = simplify(gaussians, cameras, rasterizer, settings=settings)
    z = result.gaussians.means[0, :, 2]
    assert ((z - 2).abs() < 0.01).logical_or((z - 4).abs() < 0.01).all()
