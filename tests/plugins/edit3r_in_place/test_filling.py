"""What a removed thing hid is closed once, and what was open before stays open."""

import pytest
import torch
from edit3r_in_place.filling import filled

import edit3r
from edit3r.contract.types import Cameras, Gaussians, GivenScene
from edit3r.kit.geometry.harmonics import colour_to_dc

SIDE, FOCAL = 48, 2.5  # focal length in widths: 1.6 of the wall is seen
POSTER = 0.25  # half its side


def wall(open_at: float) -> Gaussians:
    """A wall at z = 4 with a square opening about x = `open_at`."""
    across, down = torch.linspace(-2, 2, 101), torch.linspace(-1.2, 1.2, 61)
    x, y = torch.meshgrid(across, down, indexing="ij")
    shown = ((x - open_at).abs() > POSTER) | (y.abs() > POSTER)
    x, y = x[shown], y[shown]
    means = torch.stack((x, y, torch.full_like(x, 4)), 1)[None]
    return Gaussians(
        means,
        torch.full_like(means, 0.03),
        torch.tensor([1.0, 0, 0, 0]).expand(1, len(x), 4),
        torch.full((1, len(x)), 0.95),
        colour_to_dc(torch.full((1, len(x), 1, 3), 0.5)),
    )


@pytest.fixture(scope="module")
def rasterizer():
    return edit3r.build("rasterizer", "numba")


def seen(gaussians, rasterizer, *places: float) -> GivenScene:
    """Pictures of the wall from places beside each other."""
    c2w = torch.eye(4).repeat(1, len(places), 1, 1)
    c2w[0, :, 0, 3] = torch.tensor(places)
    lens = torch.tensor([[FOCAL, 0, 0.5], [0, FOCAL, 0.5], [0, 0, 1]])
    cameras = Cameras(c2w, lens.repeat(1, len(places), 1, 1), (SIDE, SIDE))
    drawn = rasterizer.render(gaussians, cameras)
    return GivenScene(
        gaussians,
        cameras,
        drawn.images,
        0.0,
        drawn.depths[:, :, 0],
        drawn.alphas[:, :, 0],
    )


def test_a_hole_that_two_pictures_show_is_closed_by_the_first(rasterizer):
    whole = seen(wall(open_at=9), rasterizer, 0.0, 0.1)
    found = filled(whole, wall(open_at=0), rasterizer)
    assert found.count > 50 and set(found.view_index.unique().tolist()) == {0}


def test_an_opening_that_was_there_before_stays_open_on_every_picture(rasterizer):
    """The first picture does not show it."""
    scene = seen(wall(open_at=0.9), rasterizer, -0.9, 0.9)
    assert bool((scene.alphas[0, 0] > 0.8).all())
    assert bool((scene.alphas[0, 1] < 0.5).any())
    assert filled(scene, scene.gaussians, rasterizer) is None
