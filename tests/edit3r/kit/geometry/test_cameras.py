import math

import torch

from edit3r.kit.geometry import cameras
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians, unproject
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.rotations import quats_to_matrices
from edit3r_testing import photograph


def _pose(seed):
    generator = torch.Generator().manual_seed(seed)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = quats_to_matrices(
        torch.randn(4, dtype=torch.float64, generator=generator)
    )
    pose[:3, 3] = torch.randn(3, dtype=torch.float64, generator=generator)
    return pose


def test_points_fall_on_the_pixels_that_show_them_and_others_are_out_of_sight():
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    ahead = torch.tensor([[-0.4, -0.4, 1], [0.4, 0.4, 1]])  # first and last of 2 by 3
    hidden = torch.tensor([[0.6, 0, 1], [0, -0.6, 1], [0, 0, -1.0]])
    points = torch.cat((2 * ahead, hidden))
    index, z, inside = cameras.project_to_pixels(points, lens, torch.eye(4), (2, 3))
    assert inside.tolist() == [True, True, False, False, False]
    assert index[inside].tolist() == [0, 5]
    assert z.tolist() == [2, 2, 1, 1, -1]


def test_unprojected_pixels_project_back_to_their_centres():
    intrinsics = torch.tensor(
        [[0.8, 0, 0.45], [0, 1.1, 0.6], [0, 0, 1]], dtype=torch.float64
    )
    depths = 1 + torch.rand(
        5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    )
    pose = _pose(1)
    points = cameras.unproject(depths, intrinsics, pose)
    image, z = cameras.project(points.flatten(0, 1), intrinsics, pose)
    assert torch.allclose(
        image.view(5, 7, 2), cameras.pixel_grid((5, 7), depths), atol=1e-12
    )
    assert torch.allclose(z.view(5, 7), depths, atol=1e-12)


def test_the_first_pixel_centre_is_half_a_pixel_from_the_corner():
    grid = cameras.pixel_grid((4, 8), torch.zeros(()))
    assert grid[0, 0].tolist() == [0.0625, 0.125]


def test_intrinsics_survive_the_way_through_pixels_and_show_their_field_of_view():
    intrinsics = cameras.intrinsics_from_fov(math.radians(60), (300, 400))
    pixels = cameras.to_pixels(intrinsics, (300, 400))
    assert torch.allclose(pixels[0, 0], pixels[1, 1])  # square pixels
    assert torch.allclose(cameras.from_pixels(pixels, (300, 400)), intrinsics)
    assert math.isclose(
        2 * math.atan(0.5 / float(intrinsics[0, 0])), math.radians(60), rel_tol=1e-6
    )


def test_invert_rigid_is_the_matrix_inverse():
    pose = _pose(2)
    assert torch.allclose(
        cameras.invert_rigid(pose), torch.linalg.inv(pose), atol=1e-12
    )


def test_relative_poses_start_at_exactly_the_identity_and_keep_what_lies_between():
    poses = torch.stack([_pose(3), _pose(4)])[None]
    relative = cameras.relative_to_first(poses)
    assert torch.equal(relative[0, 0], torch.eye(4, dtype=torch.float64))
    assert torch.allclose(poses[0, 0] @ relative[0, 1], poses[0, 1], atol=1e-12)


def test_points_behind_the_camera_give_finite_coordinates_and_negative_z():
    image, z = cameras.project(
        torch.tensor([[0.0, 0, 0], [1, 1, -1]]),
        cameras.intrinsics_from_fov(1.0, (4, 4)),
        torch.eye(4),
    )
    assert torch.isfinite(image).all() and z.tolist() == [0, -1]


def test_size_of_a_gaussian_is_its_pixel_at_its_depth():
    scene = photograph(2, (12, 16))
    scales = pixel_scales(scene.depths, scene.views.intrinsics, footprint=0.5)
    focal = scene.views.intrinsics[0, 0, 0, 0] * scene.views.image_size[1]
    assert torch.allclose(scales, 0.5 * scene.depths / focal, rtol=1e-6)


def test_gaussians_follow_the_pixels_view_by_view_and_row_by_row():
    scene = photograph(2, (12, 16), batch=2)
    images = scene.views.images
    gaussians = pixels_to_gaussians(
        images, scene.depths, scene.cameras, 0.1 * scene.depths, scene.depths / 10
    )
    assert gaussians.view_index.tolist() == [0] * 192 + [1] * 192
    points = unproject(scene.depths, scene.views.intrinsics, scene.cameras.c2w)
    assert torch.equal(gaussians.means, points.flatten(1, 3))
    assert torch.equal(gaussians.scales[..., 2], 0.1 * scene.depths.flatten(1))
    assert torch.equal(gaussians.opacities, scene.depths.flatten(1) / 10)
    assert torch.allclose(
        dc_to_colour(gaussians.harmonics[:, :, 0]),
        images.movedim(2, -1).flatten(1, 3),
        atol=1e-6,
    )


def test_poses_in_another_unit_keep_their_rotations():
    poses = torch.eye(4).repeat(2, 3, 1, 1)
    poses[:, 1:, :3, 3] = (
        torch.rand(2, 2, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    )
    scaled = cameras.scale_poses(poses, torch.tensor([[2.0], [0.5]]))
    assert torch.equal(scaled[..., :3, :3], poses[..., :3, :3])
    assert torch.equal(scaled[0, :, :3, 3], 2 * poses[0, :, :3, 3])
    assert torch.equal(cameras.scale_poses(poses[0], 2.0), scaled[0])
