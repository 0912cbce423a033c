"""Depth of what is selected ends where its outline does."""

import pytest
import torch

from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import pixels_to_gaussians, project
from edit3r.running.edges import edges_on_outlines

SIZE = 100
NEAR, FAR = 2.0, 4.0


@pytest.fixture
def cameras():
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return Cameras(torch.eye(4)[None, None], lens[None, None], (SIZE, SIZE))


def moved(cameras, depths, masks):
    """Depths after depth and outline were brought together."""
    images, whole = torch.full((1, 1, 3, SIZE, SIZE), 0.5), torch.ones_like(depths)
    gaussians = pixels_to_gaussians(images, depths, cameras, depths / SIZE, whole)
    found = edges_on_outlines(gaussians, cameras, depths, masks)
    _, z = project(found.means[0], cameras.intrinsics[0, 0], cameras.c2w[0, 0])
    assert torch.allclose(found.scales[0, :, 0] * SIZE, z, rtol=1e-4)
    return z.view(SIZE, SIZE)


def square(first, last, inside, outside):
    values = torch.full((1, 1, SIZE, SIZE), outside)
    values[..., first:last, first:last] = inside
    return values


@pytest.mark.parametrize("beside", [-1, 1])
def test_depth_that_ends_beside_the_outline_is_moved_onto_it(cameras, beside):
    depths = square(30 - beside, 70 + beside, NEAR, FAR)
    wanted = square(30, 70, NEAR, FAR)
    found = moved(cameras, depths, square(30, 70, 1.0, 0.0))
    assert torch.allclose(found, wanted[0, 0], rtol=1e-4)


def test_nothing_moves_where_what_is_selected_lies_behind_or_depth_ends_far_away(
    cameras,
):
    masks = square(30, 70, 1.0, 0.0)
    for depths in (square(15, 85, NEAR, FAR), square(31, 69, FAR, NEAR)):
        assert torch.allclose(moved(cameras, depths, masks), depths[0, 0], rtol=1e-4)


def test_a_thin_part_without_depth_of_its_own_stays_where_it_was_measured(cameras):
    depths, masks = square(30, 70, NEAR, FAR), square(30, 70, 1.0, 0.0)
    masks[..., 5:30, 49:51] = 1
    pole = moved(cameras, depths, masks)[5:20, 49:51]
    assert torch.allclose(pole, torch.full_like(pole, FAR), rtol=1e-4)
