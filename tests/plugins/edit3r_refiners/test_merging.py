"""What an earlier view shows is not needed twice."""

from dataclasses import replace

import torch
from edit3r_refiners.merging import duplicates, place
from edit3r_refiners.settings import SimplifySettings

from edit3r.geometry.harmonics import colour_to_dc

from .scenes import cameras_side_by_side, flat_wall, gaussian_per_pixel


def found(gaussians, cameras, **settings):
    return duplicates(
        gaussians, cameras, place(gaussians, cameras), SimplifySettings(**settings)
    )


def test_the_second_view_of_a_wall_keeps_only_what_the_first_does_not_show():
    gaussians, cameras = flat_wall(views=2)
    twice = found(gaussians, cameras)
    first, second = twice.view(2, 64, 64)
    assert not first.any()
    shift = round(
        0.1 / 2.0 * float(cameras.intrinsics[0, 0, 0, 0]) * 64
    )  # disparity of the wall [pixels]
    assert second[:, : 64 - shift - 1].all() and not second[:, 64 - shift + 1 :].any()


def test_another_colour_or_another_depth_is_no_duplicate():
    gaussians, cameras = flat_wall(views=2)
    second = gaussians.view_index == 1
    red = replace(gaussians, harmonics=gaussians.harmonics.clone())
    red.harmonics[:, second] = colour_to_dc(torch.tensor([0.9, 0.1, 0.1]))
    assert not found(red, cameras).any()
    nearer = replace(gaussians, means=gaussians.means.clone())
    nearer.means[:, second, 2] -= 0.5
    assert not found(nearer, cameras).any()


def test_a_view_from_closer_by_keeps_its_finer_pixels():
    cameras = cameras_side_by_side(2, (32, 32), step=0.0)
    cameras.c2w[0, 1, 2, 3] = 1.0
    depths = torch.stack((torch.full((32, 32), 2.0), torch.full((32, 32), 1.0)))
    gaussians = gaussian_per_pixel(torch.full((2, 3, 32, 32), 0.6), depths, cameras)
    assert not found(gaussians, cameras).any()


def test_of_three_views_of_one_place_only_the_first_stays():
    gaussians, cameras = flat_wall(views=3, size=16)
    cameras.c2w[0, :, 0, 3] = 0
    gaussians = gaussian_per_pixel(
        torch.full((3, 3, 16, 16), 0.6), torch.full((3, 16, 16), 2.0), cameras
    )
    assert found(gaussians, cameras).view(3, -1).all(1).tolist() == [False, True, True]


def test_transparent_gaussians_hide_no_duplicate():
    gaussians, cameras = flat_wall(views=2, size=16)
    assert not found(
        replace(gaussians, opacities=gaussians.opacities * 0.3), cameras
    ).any()
