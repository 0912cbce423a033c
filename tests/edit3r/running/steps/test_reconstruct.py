"""What leaves the scene, and where it may change."""

from types import SimpleNamespace

import torch

from edit3r.contract.types import Cameras, Gaussians, Reconstruction
from edit3r.running.steps.reconstruct import _masks_of_change, _only_placed


def test_gaussians_of_no_photo_stay_where_a_photo_has_no_place():
    count = 4
    gaussians = Gaussians(
        torch.arange(3.0 * count).view(1, count, 3),
        torch.ones(1, count, 3),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.ones(1, count),
        torch.zeros(1, count, 1, 3),
        torch.tensor([0, 1, 2, -1]),
    )
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).expand(1, 3, 3, 3)
    cameras = Cameras(torch.eye(4).expand(1, 3, 4, 4), lens, (8, 8))
    placed = torch.tensor([[True, False, True]])
    left = _only_placed(Reconstruction(gaussians, cameras, placed=placed))
    assert left.gaussians.view_index.tolist() == [0, 1, -1]
    assert torch.equal(left.gaussians.means, gaussians.means[:, [0, 2, 3]])


def test_photos_that_are_not_edited_hold_nothing_back():
    start = SimpleNamespace(images=torch.zeros(1, 3, 3, 4, 6))
    edited = start.images.clone()
    edited[:, 0, 1, 2, 3] = 1
    changed = _masks_of_change(
        SimpleNamespace(start=start, before=object()),
        SimpleNamespace(masks=None),
        SimpleNamespace(views=SimpleNamespace(images=edited)),
        SimpleNamespace(edited_count=lambda views: 1),
    )
    assert changed[0, 0].nonzero().tolist() == [[2, 3]] and changed[0, 1:].all()
