"""Photos to the network's size and Gaussians back to the photo's."""

import pytest
import torch
import torch.nn.functional as F
from edit3r_model.view_fitting import fit_views

from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov, pixel_rays
from edit3r.kit.geometry.harmonics import colour_to_dc


def views_of(*size: int) -> Views:
    lens = intrinsics_from_fov(1.0, size)
    return Views(torch.rand(1, 2, 3, *size), lens.repeat(1, 2, 1, 1))


@pytest.mark.parametrize("mode", ["resize", "pad"])
@pytest.mark.parametrize("size", [(1, 1), (16, 16), (100, 75), (3000, 20), (333, 500)])
def test_fitted_sides_are_multiples_and_within_the_budget(size, mode):
    height, width = fit_views(views_of(*size), 16, 64, mode).views.image_size
    assert height % 16 == width % 16 == 0
    assert height * width <= (64 + 16) ** 2 * (2 if min(size) < 32 else 1)


def test_an_image_that_fits_is_the_same_tensor():
    views = views_of(48, 80)
    assert fit_views(views, 16, 256, "resize").views.images is views.images


def test_padding_keeps_the_rays_of_the_photos_pixels():
    views = views_of(40, 50)
    fitted = fit_views(views, 16, 256, "pad")
    assert fitted.views.image_size == (48, 64) and fitted.inner_size == (40, 50)
    rays = pixel_rays(fitted.views.intrinsics, (48, 64))[:, :, :40, :50]
    expected = pixel_rays(views.intrinsics, (40, 50))
    torch.testing.assert_close(rays, expected, atol=1e-5, rtol=1e-5)


def test_resizing_keeps_the_corner_rays():
    views = views_of(40, 50)
    fitted = fit_views(views, 16, 256, "resize").views
    assert fitted.image_size in ((48, 48), (32, 48))
    torch.testing.assert_close(fitted.intrinsics, views.intrinsics)


def gaussians_at(means: torch.Tensor, views: int = 1, colours=0.5) -> Gaussians:
    count = means.shape[1]
    return Gaussians(
        means,
        torch.full((1, count, 3), 0.02),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.full((1, count), 0.7),
        colour_to_dc(torch.zeros(1, count, 3) + colours)[:, :, None],
        torch.arange(views).repeat_interleave(count // views),
    )


def test_padded_pixels_leave_no_gaussians():
    fitted = fit_views(views_of(40, 50), 16, 256, "pad")
    places = torch.cartesian_prod(torch.arange(48.0), torch.arange(64.0))
    means = F.pad(places, (0, 1)).repeat(2, 1)[None]
    made = Reconstruction(gaussians_at(means, views=2))
    kept = fitted.drop_padding(made).gaussians
    assert kept.count == 2 * 40 * 50
    assert kept.means[0].amax(0).tolist() == [39, 49, 0]
