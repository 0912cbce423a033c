import torch
from edit3r_model.surface import discs, surface_normals

from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import pixels_to_gaussians, unproject
from edit3r.kit.geometry.rotations import quats_to_matrices

SIZE = (24, 32)
K = torch.tensor([[1.1, 0, 0.5], [0, 1.4, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
NORMAL = torch.nn.functional.normalize(torch.tensor([0.6, 0.2, 1.0]), dim=0)


def flattened(thickness: float):
    """Round Gaussians of the plane n.x = 3 in two cameras, the second turned half around the z axis
    and moved; and the discs of them.
    """
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, :2, :2] *= -1
    c2w[0, 1, 0, 3] = 0.4
    rays = unproject(torch.ones(1, 2, *SIZE), K, c2w) - c2w[:, :, None, None, :3, 3]
    start = (c2w[:, :, :3, 3] @ NORMAL)[..., None, None]
    depths = (3 - start) / (rays @ NORMAL)
    scales, black = torch.full_like(depths, 0.02), torch.zeros(1, 2, 3, *SIZE)
    cameras = Cameras(c2w, K, SIZE)
    round_ones = pixels_to_gaussians(black, depths, cameras, scales, scales)
    return round_ones, discs(round_ones, (2, *SIZE), thickness)


def test_the_short_axis_of_every_disc_is_the_surface_s_normal_whatever_the_view():
    _, flat = flattened(0.25)
    axes = quats_to_matrices(flat.quats[0])[..., 2]
    assert torch.allclose(axes @ NORMAL, torch.ones(len(axes)), atol=1e-4)
    shape = torch.tensor([0.02, 0.02, 0.005]).expand(len(axes), 3)
    assert torch.allclose(flat.scales[0], shape)


def test_nothing_else_changes_and_a_thickness_of_1_stays_round():
    round_ones, flat = flattened(1.0)
    assert torch.equal(flat.scales, round_ones.scales)
    assert torch.equal(flat.means, round_ones.means)


def test_an_edge_of_depth_is_not_bridged():
    depths = torch.full((1, 1, *SIZE), 2.0)
    depths[..., 16:] = 4.0
    points = unproject(depths, K[:, :1], torch.eye(4).expand(1, 1, 4, 4))
    upright = torch.ones(1, 1, *SIZE)
    assert torch.allclose(surface_normals(points)[..., 2], upright, atol=1e-4)


def test_points_that_coincide_have_a_normal_all_the_same():
    normals = surface_normals(torch.zeros(1, 1, 8, 8, 3))
    assert torch.equal(normals[..., 2], torch.ones(1, 1, 8, 8))
