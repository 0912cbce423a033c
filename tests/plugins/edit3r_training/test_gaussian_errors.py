import math
from dataclasses import replace

import pytest
import torch
from edit3r_training.batches import TrainingBatch
from edit3r_training.gaussian_errors import (
    PixelMaps,
    colour_error,
    depth_error,
    opacity_error,
    pixel_maps,
)

from edit3r.contract.errors import SettingsError
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.geometry.harmonics import colour_to_dc

VIEWS, HEIGHT, WIDTH = 2, 3, 4
PIXELS = VIEWS * HEIGHT * WIDTH
CAMERAS = Cameras(
    torch.eye(4).repeat(1, VIEWS, 1, 1),
    torch.eye(3).repeat(1, VIEWS, 1, 1),
    (HEIGHT, WIDTH),
)


def _reconstruction(count: int) -> Reconstruction:
    """Gaussian i has the colour i / 100 and the depth i + 1."""
    number = torch.arange(count, dtype=torch.float32)
    means = torch.stack((number, number, number + 1), -1)[None]
    colours = (number / 100)[None, :, None, None].expand(1, count, 1, 3)
    quats = torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4)
    return Reconstruction(
        Gaussians(
            means,
            torch.ones(1, count, 3),
            quats,
            torch.full((1, count), 0.5),
            colour_to_dc(colours),
        )
    )


@pytest.mark.parametrize("rim", [0, 5])
def test_pixels_are_in_view_major_row_major_order_and_a_rim_beyond_them_is_left_out(
    rim,
):
    maps = pixel_maps(_reconstruction(PIXELS + rim), CAMERAS)
    expected = torch.arange(PIXELS, dtype=torch.float32).reshape(
        1, VIEWS, HEIGHT, WIDTH
    )
    assert torch.allclose(maps.colours[:, :, 0], expected / 100, atol=1e-6)
    assert torch.equal(maps.depths, expected + 1)


def test_several_gaussians_of_a_pixel_are_blended():
    made = _reconstruction(3 * PIXELS)
    opacities = torch.tensor([0.0, 0.25, 0.75]).repeat(1, PIXELS)
    gaussians = replace(made.gaussians, opacities=opacities)
    maps = pixel_maps(replace(made, gaussians=gaussians, per_pixel=3), CAMERAS)
    first = 3 * torch.arange(PIXELS).reshape(1, VIEWS, HEIGHT, WIDTH)
    assert torch.allclose(maps.colours[:, :, 0], (first + 1.75) / 100, atol=1e-6)
    assert torch.allclose(maps.depths, first + 2.75)
    assert torch.allclose(maps.opacities, torch.tensor(1 - 0.75 * 0.25))
    with pytest.raises(SettingsError, match="score to renderings"):
        pixel_maps(replace(made, per_pixel=0), CAMERAS)


def test_fewer_gaussians_than_pixels_are_refused():
    with pytest.raises(
        SettingsError, match=f"{PIXELS - 1} Gaussians for {PIXELS} pixels"
    ):
        pixel_maps(_reconstruction(PIXELS - 1), CAMERAS)


def test_depths_are_those_in_the_predicted_cameras_or_else_in_the_true_ones():
    answer = _reconstruction(PIXELS)

    def moved(back: float) -> Cameras:
        c2w = torch.eye(4).repeat(1, VIEWS, 1, 1)
        c2w[:, 1, 2, 3] = -back  # view 1 stands that far behind view 0
        return Cameras(c2w, CAMERAS.intrinsics, CAMERAS.image_size)

    own = answer.gaussians.means[..., 2].reshape(1, VIEWS, HEIGHT, WIDTH)
    alone = pixel_maps(answer, moved(10)).depths
    assert torch.equal(alone[:, 0], own[:, 0])
    assert torch.equal(alone[:, 1], own[:, 1] + 10)
    placed = pixel_maps(replace(answer, cameras=moved(3)), moved(10)).depths
    assert torch.equal(placed[:, 1], own[:, 1] + 3)


def _batch(source: Views, truth: torch.Tensor, depths: torch.Tensor) -> TrainingBatch:
    images = {"source": source, "edited": source, "truth": truth}
    cameras = {"context_cameras": CAMERAS, "target_cameras": CAMERAS.select([0])}
    rest = {"target": truth[:, :0], "depths": depths, "geometry": None}
    return TrainingBatch(**images, **cameras, **rest)


@pytest.mark.parametrize(("off", "error"), [(0.02, 0.004), (0.3, 0.275)])
def test_a_colour_error_is_squared_up_to_a_twentieth_and_linear_beyond(off, error):
    """Below 0.05 d^2 / 0.1, above it d - 0.025; nothing was edited: twice the mean alone."""
    images = torch.full((1, VIEWS, 3, HEIGHT, WIDTH), 0.5)
    maps = PixelMaps(images + off, torch.ones(1, VIEWS, HEIGHT, WIDTH), images[:, :, 0])
    source = Views(images, CAMERAS.intrinsics)
    value = colour_error(maps, _batch(source, images, maps.depths))
    assert float(value) == pytest.approx(2 * error, rel=1e-4)


@pytest.mark.parametrize(("off", "error"), [(0.012, 0.0024), (0.3, 0.285)])
def test_a_depth_error_is_squared_up_to_three_percent_and_linear_beyond(off, error):
    """Of log depth: below 0.03 d^2 / 0.06, above it d - 0.015; an even error has no slope."""
    images = torch.full((1, VIEWS, 3, HEIGHT, WIDTH), 0.5)
    depths = torch.full((1, VIEWS, HEIGHT, WIDTH), 2.0)
    maps = PixelMaps(images, depths * math.exp(off), images[:, :, 0])
    source = Views(images, CAMERAS.intrinsics)
    value = depth_error(maps, _batch(source, images, depths))
    assert float(value) == pytest.approx(error, rel=1e-3)


def test_a_surface_that_an_edit_may_have_moved_has_no_error_of_depth_or_opacity():
    depths = torch.full((1, 2, 3, 4), 2.0)
    truth = torch.rand(1, 2, 3, 3, 4)
    batch = _batch(Views(truth, CAMERAS.intrinsics), truth, depths)
    maps = PixelMaps(truth, depths.clone(), torch.full((1, 2, 3, 4), 0.9))
    maps.depths[:, 1] = 3.0
    moved = torch.zeros(1, 2, 3, 4, dtype=torch.bool)
    moved[:, 1] = True
    free = replace(batch, reshaped=moved)
    exact = replace(maps, depths=depths)
    assert float(depth_error(maps, batch)) > 0.1
    assert float(depth_error(maps, free)) == 0
    assert float(opacity_error(maps, batch)) > float(opacity_error(exact, batch)) + 0.3
    half = 0.5 * float(opacity_error(exact, batch))
    assert float(opacity_error(maps, free)) == pytest.approx(half)
