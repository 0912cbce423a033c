"""The place behind an object that went away is closed by what is around it."""

from dataclasses import replace

import pytest
import torch
from edit3r_objects.holes import without_object

from edit3r import Cameras, Gaussians, build

SIZE = 64
PLATE, WALL = 1.0, 2.0  # depths
RASTERIZER = build("rasterizer", "numba")


def plane(half, depth, count):
    line = torch.linspace(-half, half, count)
    y, x = torch.meshgrid(line, line, indexing="ij")
    return torch.stack((x, y, torch.full_like(x, depth)), -1).view(-1, 3)


def scene_of(means):
    """Wide Gaussians, grey on the left and white on the right."""
    total = len(means)
    shade = (0.5 + means[:, 0] / means[:, 2] / 2)[None, :, None, None]
    return Gaussians(
        means[None],
        means[None, :, 2:].expand(-1, -1, 3) * 0.012,
        torch.tensor([1.0, 0, 0, 0]).expand(1, total, 4),
        torch.full((1, total), 0.95),
        ((shade - 0.5) / 0.2820948).expand(-1, -1, -1, 3).contiguous(),
    )


@pytest.fixture(scope="module")
def hidden():
    """A plate before a wall that has a hole behind it: scene, the plate's own, cameras."""
    wall = plane(1.2, WALL, 60)
    behind = wall[:, :2].abs().amax(1) < 0.5
    plate = plane(0.24, PLATE, 24)
    scene = scene_of(torch.cat((wall[~behind], plate)))
    own = scene.means[0, :, 2] == PLATE
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 0.05
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).repeat(1, 2, 1, 1)
    return scene, own, Cameras(c2w, lens, (SIZE, SIZE))


def test_the_hole_continues_the_wall_in_colour_and_depth(hidden):
    scene, own, cameras = hidden
    whole, guessed = without_object(scene, own, cameras, RASTERIZER)
    shown = RASTERIZER.render(whole, cameras)
    middle = (..., slice(12, -12), slice(12, -12))
    assert shown.alphas[middle].min() > 0.85
    assert (shown.depths[middle] - WALL).abs().max() < 0.1
    rows = torch.linspace(0.5 / SIZE, 1 - 0.5 / SIZE, SIZE) - 0.5
    expected = (0.5 + rows / 2)[12:-12]
    image = (shown.images / shown.alphas)[0, 0, 0][12:-12, 12:-12]
    assert (image - expected).abs().max() < 0.06
    assert 0 < guessed < 0.3 * SIZE**2


def test_guesses_are_the_last_ones_and_know_their_view(hidden):
    scene, own, cameras = hidden
    whole, guessed = without_object(scene, own, cameras, RASTERIZER)
    guesses = whole.select(torch.arange(whole.count - guessed, whole.count))
    assert set(guesses.view_index.tolist()) <= {0, 1}
    assert (guesses.means[0, :, 2] - WALL).abs().max() < 0.1
    assert (guesses.objects == -1).all()


def test_colours_at_the_rim_of_the_hole_are_not_continued(hidden):
    """There they are mixed with what went away."""
    scene, own, cameras = hidden
    half = scene.means[0, :, :2].abs().amax(1)
    rim = (scene.means[0, :, 2] == WALL) & (half < 0.53)
    harmonics = scene.harmonics.clone()
    harmonics[0, rim, 0] = torch.tensor([0.5, -0.5, -0.5])  # red
    scene = replace(scene, harmonics=harmonics)
    whole, guessed = without_object(scene, own, cameras, RASTERIZER)
    colours = whole.harmonics[0, -guessed:, 0]
    assert (colours.amax(1) - colours.amin(1)).max() < 0.1


def test_what_another_view_shows_beside_the_object_stays(hidden):
    cameras = hidden[2]
    scene = scene_of(torch.cat((plane(1.2, WALL, 60), plane(0.24, PLATE, 24))))
    own = scene.means[0, :, 2] == PLATE
    c2w = cameras.c2w.clone()
    c2w[0, 1, 0, 3] = 0.6  # sees the right half of what view 0 does not
    cameras = replace(cameras, c2w=c2w)
    whole, guessed = without_object(scene, own, cameras, RASTERIZER)
    known = whole.select(torch.arange(whole.count - guessed)).means[0]
    right = scene.means[0, :, 2] == WALL
    right &= (scene.means[0, :, 0] > 0.1) & (scene.means[0, :, 0] < 1)
    kept = (known[:, 0] > 0.1) & (known[:, 0] < 1)
    assert kept.sum() == right.sum()


def test_another_object_that_it_hid_stays_whole(hidden):
    cameras = hidden[2]
    scene = scene_of(torch.cat((plane(1.2, WALL, 60), plane(0.24, PLATE, 24))))
    own = scene.means[0, :, 2] == PLATE
    behind = ~own & (scene.means[0, :, :2].abs().amax(1) < 0.3)
    index = torch.where(own, 0, torch.where(behind, 1, -1))
    scene = replace(scene, object_index=index)
    whole, _ = without_object(scene, own, cameras, RASTERIZER)
    assert (whole.objects == 1).sum() == behind.sum()
    assert not (whole.objects == 0).any()


@pytest.mark.slow
def test_a_thin_edge_that_the_mask_missed_goes_with_the_object(hidden):
    cameras = replace(hidden[2], image_size=(2 * SIZE, 2 * SIZE))
    plate = scene_of(plane(0.24, PLATE, 90))
    plate = replace(plate, scales=plate.scales / 4)
    scene = Gaussians.cat([hidden[0].select(~hidden[1]), plate])
    own = scene.means[0, :, 2] == PLATE
    missed = own & (scene.means[0, :, :2].abs().amax(1) > 0.232)
    whole, guessed = without_object(scene, own & ~missed, cameras, RASTERIZER)
    left = whole.means[0, : whole.count - guessed, 2] == PLATE
    assert missed.sum() > 500
    assert left.sum() < 0.2 * missed.sum()
