"""Scenes in other axes: what they show stays."""

import torch

from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.harmonics import basis
from edit3r.kit.geometry.rotations import covariances
from edit3r.kit.scenes.axes import UP_AND_BACK, flipped

GENERATOR = torch.Generator().manual_seed(0)


def random(*shape):
    return torch.randn(shape, generator=GENERATOR, dtype=torch.float64)


def test_a_flipped_scene_shows_in_flipped_directions_what_the_scene_shows():
    quats = torch.nn.functional.normalize(random(1, 5, 4), dim=-1)
    scene = Gaussians(
        random(1, 5, 3),
        random(1, 5, 3).exp(),
        quats,
        torch.ones(1, 5).double(),
        random(1, 5, 25, 3),
    )
    flip = torch.tensor(UP_AND_BACK).double()
    other = flipped(scene, UP_AND_BACK)
    torch.testing.assert_close(other.means, scene.means * flip)
    before, after = (covariances(one.scales, one.quats) for one in (scene, other))
    torch.testing.assert_close(after, before * flip[:, None] * flip)
    directions = torch.nn.functional.normalize(random(30, 3), dim=-1)
    seen = torch.einsum("dk,bgkc->bgdc", basis(directions, 4), scene.harmonics)
    there = torch.einsum("dk,bgkc->bgdc", basis(directions * flip, 4), other.harmonics)
    torch.testing.assert_close(there, seen)
    again = flipped(other, UP_AND_BACK)
    assert torch.equal(again.harmonics, scene.harmonics)
