"""Photos to the network's size and Gaussians back to the photo's."""

import pytest
import torch
from edit3r_model.view_fitting import finer_grid, fit_views, regrid

from edit3r.contract.types import Gaussians, Views
from edit3r.geometry.cameras import intrinsics_from_fov, pixel_rays
from edit3r.geometry.harmonics import colour_to_dc, dc_to_colour


def views_of(height: int, width: int) -> Views:
    return Views(
        torch.rand(1, 2, 3, height, width),
        intrinsics_from_fov(1.0, (height, width)).repeat(1, 2, 1, 1),
    )


@pytest.mark.parametrize("mode", ["resize", "pad"])
@pytest.mark.parametrize("size", [(1, 1), (16, 16), (100, 75), (3000, 20), (333, 500)])
def test_fitted_sides_are_multiples_and_within_the_budget(size, mode):
    height, width = fit_views(views_of(*size), 16, 64, mode).views.image_size
    assert height % 16 == width % 16 == 0
    assert height * width <= (64 + 16) ** 2 * (2 if min(size) < 32 else 1)


def test_a_picture_that_fits_is_the_same_tensor():
    views = views_of(48, 80)
    assert fit_views(views, 16, 256, "resize").views.images is views.images


def test_padding_keeps_the_rays_of_the_photos_pixels():
    views = views_of(40, 50)
    fitted = fit_views(views, 16, 256, "pad")
    assert fitted.views.image_size == (48, 64) and fitted.inner_size == (40, 50)
    rays = pixel_rays(fitted.views.intrinsics, (48, 64))[:, :, :40, :50]
    torch.testing.assert_close(
        rays, pixel_rays(views.intrinsics, (40, 50)), atol=1e-5, rtol=1e-5
    )


def test_resizing_keeps_the_corner_rays():
    views = views_of(40, 50)
    fitted = fit_views(views, 16, 256, "resize")
    assert fitted.views.image_size == (48, 48) or fitted.views.image_size == (32, 48)
    torch.testing.assert_close(fitted.views.intrinsics, views.intrinsics)


def test_padded_pixels_leave_no_gaussians():
    fitted = fit_views(views_of(40, 50), 16, 256, "pad")
    rows = torch.arange(48)[:, None].expand(48, 64)
    columns = torch.arange(64).expand(48, 64)
    means = (
        torch.stack((rows, columns, rows), -1).float().flatten(0, 1).repeat(2, 1)[None]
    )
    kept = fitted.drop_padding(gaussians_at(means, views=2))
    assert kept.count == 2 * 40 * 50
    assert kept.means[0, :, 0].max() == 39 and kept.means[0, :, 1].max() == 49


def gaussians_at(
    means: torch.Tensor, views: int, colours: torch.Tensor | None = None
) -> Gaussians:
    batch, count = means.shape[:2]
    colours = torch.full((batch, count, 3), 0.5) if colours is None else colours
    return Gaussians(
        means,
        torch.full((batch, count, 3), 0.02),
        torch.tensor([1.0, 0, 0, 0]).expand(batch, count, 4),
        torch.full((batch, count), 0.7),
        colour_to_dc(colours)[:, :, None],
        torch.arange(views).repeat_interleave(count // views),
    )


def plane(size: tuple[int, int], depth) -> torch.Tensor:
    rays = pixel_rays(intrinsics_from_fov(1.0, (4, 4)), size)
    return (rays * depth).flatten(0, 1)[None]


def test_a_finer_grid_shows_the_photos_own_colours():
    photo = torch.rand(1, 1, 3, 16, 16)
    coarse = torch.nn.functional.interpolate(
        photo[0], (4, 4), mode="bicubic", antialias=True
    ).clamp(0, 1)
    colours = coarse[0].flatten(1).T[None]
    fine = regrid(gaussians_at(plane((4, 4), 2.0), 1, colours), (4, 4), (16, 16), photo)
    shown = dc_to_colour(fine.harmonics[0, :, 0]).T.unflatten(1, (16, 16))
    torch.testing.assert_close(shown, photo[0, 0], atol=1e-5, rtol=0)


def test_a_finer_grid_keeps_a_plane_flat_and_scales_to_the_spacing():
    fine = regrid(
        gaussians_at(plane((4, 4), 2.0), 1), (4, 4), (8, 8), torch.rand(1, 1, 3, 8, 8)
    )
    torch.testing.assert_close(fine.means[..., 2], torch.full((1, 64), 2.0))
    torch.testing.assert_close(fine.scales, torch.full((1, 64, 3), 0.01))


def test_no_centre_floats_between_two_surfaces():
    depth = torch.where(torch.arange(4) < 2, 1.0, 3.0)[None, :, None]
    fine = regrid(
        gaussians_at(plane((4, 4), depth), 1),
        (4, 4),
        (16, 16),
        torch.rand(1, 1, 3, 16, 16),
    )
    assert set(fine.means[0, :, 2].round(decimals=4).tolist()) == {1.0, 3.0}


@pytest.mark.parametrize(
    ("photo", "resolution", "expected"),
    [
        ((100, 200), 512, (100, 200)),
        ((8, 8), 512, (32, 48)),
        ((400, 400), 100, (100, 100)),
    ],
)
def test_the_finer_grid_is_the_photos_within_limits(photo, resolution, expected):
    assert finer_grid((32, 48), photo, resolution) == expected
