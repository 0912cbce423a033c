import torch

from edit3r.geometry.alignment import median_scale
from edit3r.geometry.cameras import scale_poses


def test_poses_in_another_unit_keep_their_rotations_and_give_the_factor_back():
    poses = torch.eye(4).repeat(2, 3, 1, 1)
    poses[:, 1:, :3, 3] = torch.rand(2, 2, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    scaled = scale_poses(poses, torch.tensor([[2.0], [0.5]]))
    assert torch.equal(scaled[..., :3, :3], poses[..., :3, :3])
    assert torch.equal(scaled[0, :, :3, 3], 2 * poses[0, :, :3, 3])
    assert torch.equal(scale_poses(poses[0], 2.0), scaled[0])
    assert torch.isclose(median_scale(poses[1, 1:, :3, 3], scaled[1, 1:, :3, 3]), torch.tensor(0.5))
    assert median_scale(poses[0, :0, :3, 3], scaled[0, :0, :3, 3]) == 1
