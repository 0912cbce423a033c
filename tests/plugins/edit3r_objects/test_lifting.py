"""Masks of views become the right Gaussians, of what is seen and of what is not."""

import pytest
import torch
from edit3r_objects.lifting import lift

from edit3r import Cameras, Gaussians, build

pytestmark = pytest.mark.slow

SIZE = 96


def wall_and_plate():
    """A wall at depth 2 and before it, at depth 1, a plate: Gaussians, cameras, plate's own."""
    parts = []
    for half, depth, count in ((1.4, 2.0, 60), (0.25, 1.0, 20)):
        line = torch.linspace(-half, half, count)
        y, x = torch.meshgrid(line, line, indexing="ij")
        parts.append(torch.stack((x, y, torch.full_like(x, depth)), -1).view(-1, 3))
    means = torch.cat(parts)[None]
    total = means.shape[1]
    gaussians = Gaussians(
        means,
        torch.full((1, total, 3), 0.02),
        torch.tensor([1.0, 0, 0, 0]).expand(1, total, 4),
        torch.full((1, total), 0.95),
        torch.zeros(1, total, 1, 3),
    )
    c2w = torch.eye(4).repeat(1, 3, 1, 1)
    c2w[0, :, 0, 3] = torch.tensor([0.0, 0.15, -0.15])
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).repeat(1, 3, 1, 1)
    return gaussians, Cameras(c2w, lens, (SIZE, SIZE)), torch.arange(total) >= 3600


def exact_masks(gaussians, cameras, own):
    """Where the plate stands in each view: its Gaussians rendered alone."""
    alphas = build("rasterizer", "torch").render(gaussians.select(own), cameras).alphas
    return (alphas[0, :, 0] > 0.5).float()


@pytest.fixture(scope="module")
def scene():
    gaussians, cameras, own = wall_and_plate()
    return gaussians, cameras, own, exact_masks(gaussians, cameras, own)


def test_a_mask_takes_the_thing_and_not_the_wall_behind_it(scene):
    gaussians, cameras, own, masks = scene
    chosen = lift(
        gaussians, cameras.select([0]), masks[:1], build("rasterizer", "torch")
    )
    assert chosen[own].float().mean() > 0.95
    hidden = (gaussians.means[0, :, :2].abs().amax(1) < 0.45) & ~own
    assert chosen[hidden].float().mean() < 0.05


@pytest.mark.slow
def test_a_view_without_a_mask_says_nothing(scene):
    gaussians, cameras, _, masks = scene
    rasterizer = build("rasterizer", "torch")
    masks = masks * torch.tensor([1.0, 1, 0])[:, None, None]
    expected = lift(gaussians, cameras.select([0, 1]), masks[:2], rasterizer)
    assert torch.equal(lift(gaussians, cameras, masks, rasterizer), expected)
    assert not lift(gaussians, cameras, masks * 0, rasterizer).any()


def test_holes_in_a_mask_are_filled_and_specks_dropped(scene):
    gaussians, cameras, own, masks = scene
    spoilt = masks[:1].clone()
    spoilt[0, 47:49, 47:49] = 0
    spoilt[0, 6:8, 6:8] = 1
    chosen = lift(gaussians, cameras.select([0]), spoilt, build("rasterizer", "torch"))
    assert chosen[own].float().mean() > 0.95
    far = gaussians.means[0, :, :2].abs().amax(1) > 0.7
    assert not chosen[far].any()


def test_the_thing_is_found_again_in_a_view_that_was_not_masked(scene):
    gaussians, cameras, _, masks = scene
    chosen = lift(
        gaussians, cameras.select([0, 1]), masks[:2], build("rasterizer", "torch")
    )
    found = exact_masks(gaussians, cameras.select([2]), chosen)[0] > 0.5
    truth = masks[2] > 0.5
    assert (found & truth).sum() / (found | truth).sum() > 0.85
