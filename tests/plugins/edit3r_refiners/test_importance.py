"""Harmonics that no picture needs go; those that one needs stay."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners.importance import (
    PATH_REDUCTION,
    PATH_WIDENING,
    drop_unneeded_harmonics,
    visible_weight,
)
from edit3r_refiners.settings import SimplifySettings
from edit3r_refiners.simplify import simplify

from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.ply import load_ply, save_ply

from .scenes import textured

STEP = 1 / 255


def with_bands(
    gaussians: Gaussians, degree: int, strength: float, only: slice = slice(None)
) -> Gaussians:
    """The same scene with random bands up to `degree`."""
    generator = torch.Generator().manual_seed(0)
    harmonics = torch.zeros(1, gaussians.count, (degree + 1) ** 2, 3)
    harmonics[:, :, :1] = gaussians.harmonics
    bands = torch.randn(harmonics[:, only, 1:].shape, generator=generator)
    harmonics[:, only, 1:] = strength * bands
    return replace(gaussians, harmonics=harmonics)


def test_bands_that_are_zero_are_not_even_rendered():
    gaussians, cameras, _ = textured()
    dark = with_bands(gaussians, 3, 0.0)
    assert drop_unneeded_harmonics(dark, [cameras], None, STEP).degree == 0


@pytest.mark.parametrize(("strength", "left"), [(1e-4, 0), (0.3, 2)])
def test_bands_go_where_no_pixel_changes_by_a_step_of_eight_bits(
    rasterizer, strength, left
):
    gaussians, cameras, _ = textured()
    coloured = with_bands(gaussians, 2, strength)
    fewer = drop_unneeded_harmonics(coloured, [cameras], rasterizer, STEP)
    assert fewer.degree == left
    before, after = (rasterizer.render(g, cameras).images for g in (coloured, fewer))
    assert float((before - after).abs().amax()) <= STEP


def test_a_pixel_of_a_smaller_and_wider_image_counts_as_the_pixels_it_stands_for():
    gaussians, cameras, _ = textured()

    class OnePixelEach:
        """Every Gaussian fills one pixel of whatever is looked at."""

        def contributions(self, gaussians, cameras):
            return torch.ones(1, gaussians.count)

    weight = visible_weight(gaussians, cameras, OnePixelEach())
    across = PATH_REDUCTION * PATH_WIDENING
    assert torch.allclose(weight, torch.full_like(weight, across**2))


def test_one_gaussian_that_shines_to_one_side_keeps_its_bands(rasterizer):
    gaussians, cameras, _ = textured()
    middle = gaussians.count // 4 + 32
    shining = with_bands(gaussians, 1, 2.0, slice(middle, middle + 1))
    assert drop_unneeded_harmonics(shining, [cameras], rasterizer, STEP).degree == 1


def test_simplify_drops_the_bands_and_the_file_gets_smaller(
    rasterizer, tmp_path, monkeypatch
):
    gaussians, cameras, _ = textured()
    coloured = with_bands(gaussians, 3, 1e-4)
    sizes, degrees = [], []
    for tolerance in (0.0, STEP):
        monkeypatch.setattr("edit3r_refiners.simplify.TOLERANCE", tolerance)
        settings = SimplifySettings(polish=0)
        result = simplify(coloured, cameras, rasterizer, settings=settings).gaussians
        save_ply(tmp_path / "scene.ply", result)
        assert load_ply(tmp_path / "scene.ply").degree == result.degree
        degrees.append(result.degree)
        sizes.append((tmp_path / "scene.ply").stat().st_size / result.count)
    assert degrees == [3, 0] and sizes[1] < 0.35 * sizes[0]
