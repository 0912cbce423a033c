"""Poses from Gaussians: known cameras are found again, bad input is named."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.errors import MatchingError
from edit3r.contract.types import Cameras, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov, pixels_to_gaussians
from edit3r.kit.geometry.pose import estimate_cameras, pixel_layout
from edit3r.kit.geometry.rotations import cross_matrix, rotation_angle

SIZE = (24, 32)


def pose(turn, shift) -> torch.Tensor:
    matrix = torch.eye(4)
    matrix[:3, :3] = torch.linalg.matrix_exp(cross_matrix(torch.tensor(turn)))
    matrix[:3, 3] = torch.tensor(shift)
    return matrix


@pytest.fixture
def scene():
    """(Gaussians on the surfaces two cameras see, views, true poses): smooth pictures, bumpy
    depth.
    """
    generator = torch.Generator().manual_seed(0)
    c2w = torch.stack((torch.eye(4), pose([0.05, -0.2, 0.03], [0.5, 0.1, -0.1])))[None]
    intrinsics = intrinsics_from_fov(1.0, SIZE).repeat(1, 2, 1, 1)
    noise = torch.rand(2, 3, 4, 5, generator=generator)
    images = torch.nn.functional.interpolate(
        noise, SIZE, mode="bicubic", align_corners=True
    ).clamp(0, 1)[None]
    depths = 2 + torch.rand(1, 2, *SIZE, generator=generator)
    sizes = torch.full_like(depths, 0.03), torch.full_like(depths, 0.9)
    cameras = Cameras(c2w, intrinsics, SIZE)
    gaussians = pixels_to_gaussians(images, depths, cameras, *sizes)
    return gaussians, Views(images, intrinsics), c2w


def test_a_known_camera_is_found_again(scene):
    gaussians, views, c2w = scene
    cameras = estimate_cameras(gaussians, views)
    torch.testing.assert_close(cameras.c2w, c2w, atol=1e-4, rtol=0)
    assert cameras.image_size == SIZE


def test_several_gaussians_of_each_pixel_find_the_camera_too(scene):
    gaussians, views, c2w = scene
    three = gaussians.select(torch.arange(gaussians.count).repeat_interleave(3))
    cameras = estimate_cameras(three, views, per_pixel=3)
    torch.testing.assert_close(cameras.c2w, c2w, atol=1e-4, rtol=0)
    with pytest.raises(MatchingError, match="not made pixel by pixel"):
        estimate_cameras(gaussians, views, per_pixel=0)


def test_a_third_of_wrong_centres_does_not_move_the_camera(scene):
    gaussians, views, c2w = scene
    means = gaussians.means.clone()
    means[:, ::3] += torch.randn(
        means[:, ::3].shape, generator=torch.Generator().manual_seed(1)
    )
    found = estimate_cameras(replace(gaussians, means=means), views).c2w
    assert rotation_angle(found[0, 1, :3, :3], c2w[0, 1, :3, :3]) < 0.01
    torch.testing.assert_close(found[0, 1, :3, 3], c2w[0, 1, :3, 3], atol=0.03, rtol=0)


def test_faint_gaussians_do_not_vote(scene):
    gaussians, views, c2w = scene
    means, opacities = gaussians.means.clone(), gaussians.opacities.clone()
    means[:, ::2] += 5
    opacities[:, ::2] = 0.1
    spoilt = replace(gaussians, means=means, opacities=opacities)
    torch.testing.assert_close(
        estimate_cameras(spoilt, views).c2w, c2w, atol=1e-4, rtol=0
    )


def test_scenes_of_any_unit_are_placed(scene):
    gaussians, views, c2w = scene
    large = replace(gaussians, means=gaussians.means * 1e5)
    found = estimate_cameras(large, views).c2w
    torch.testing.assert_close(
        found[0, 1, :3, 3] / 1e5, c2w[0, 1, :3, 3], atol=1e-4, rtol=0
    )


def test_the_same_gaussians_give_the_same_cameras(scene):
    gaussians, views, _ = scene
    assert torch.equal(
        estimate_cameras(gaussians, views).c2w, estimate_cameras(gaussians, views).c2w
    )


def test_pictures_larger_than_the_grid_keep_their_own_size(scene):
    gaussians, views, c2w = scene
    larger = Views(torch.rand(1, 2, 3, 96, 128), views.intrinsics)
    cameras = estimate_cameras(gaussians, larger)
    assert cameras.image_size == (96, 128)
    torch.testing.assert_close(cameras.c2w, c2w, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("count", "image_size", "expected"),
    [
        (768, (24, 32), (24, 32)),
        (768, (32, 24), (32, 24)),
        (65536, (500, 480), (256, 256)),
        (7, (1, 9), (1, 7)),
    ],
)
def test_the_grid_follows_the_pictures_shape(count, image_size, expected):
    assert pixel_layout(count, image_size) == expected


def test_invisible_gaussians_are_an_error_that_names_the_view(scene):
    gaussians, views, _ = scene
    faint = replace(gaussians, opacities=gaussians.opacities * 0)
    with pytest.raises(MatchingError, match=r"right\.jpg cannot be placed"):
        estimate_cameras(
            faint, Views(views.images, views.intrinsics, ("left.jpg", "right.jpg"))
        )


def test_a_view_without_gaussians_is_an_error(scene):
    gaussians, views, _ = scene
    with pytest.raises(MatchingError, match="view 1"):
        estimate_cameras(gaussians.from_view(0), views)
