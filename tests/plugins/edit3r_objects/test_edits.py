"""Edits change the chosen Gaussians as said, and leave every other as it was."""

import math

import pytest
import torch
from edit3r_objects import edits

from edit3r import Gaussians, build
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.harmonics import basis, colour_to_dc, dc_to_colour
from edit3r.kit.geometry.rotations import covariances, quats_to_matrices

CHOSEN = torch.arange(40) < 15


def scene(degree=3):
    generator = torch.Generator().manual_seed(0)
    harmonics = torch.randn(1, 40, (degree + 1) ** 2, 3, generator=generator) * 0.1
    harmonics[0, :, 0] = colour_to_dc(
        torch.tensor([0.7, 0.15, 0.1]) * torch.linspace(0.5, 1, 40)[:, None]
    )
    return Gaussians(
        torch.randn(1, 40, 3, generator=generator) + torch.tensor([0.0, 0, 4]),
        torch.rand(1, 40, 3, generator=generator),
        torch.randn(1, 40, 4, generator=generator),
        torch.rand(1, 40, generator=generator),
        harmonics,
    )


def recoloured(gaussians, chosen):
    return edits.painted(gaussians, chosen, "blue", build("editor", "recolor"))


@pytest.mark.parametrize(
    "edit",
    [
        lambda g, c: edits.moved(g, c, (0.1, 0.2, 0.3)),
        lambda g, c: edits.turned(g, c, 30),
        lambda g, c: edits.scaled(g, c, 2),
        recoloured,
    ],
)
def test_the_rest_of_the_scene_keeps_its_bits(edit):
    before = scene()
    after = edit(before, CHOSEN)
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        old, new = getattr(before, name), getattr(after, name)
        assert torch.equal(old[:, ~CHOSEN], new[:, ~CHOSEN])
    assert not all(
        torch.equal(getattr(before, name), getattr(after, name))
        for name in ("means", "harmonics")
    )


def test_steps_go_right_up_and_nearer_in_shares_of_the_depth():
    before = scene()
    depth = before.means[0, :, 2].median()
    shift = edits.moved(before, CHOSEN, (0.1, 0.2, 0.3)).means - before.means
    expected = depth * torch.tensor([0.1, -0.2, -0.3])
    torch.testing.assert_close(shift[0, 0], expected, rtol=0, atol=1e-5)


def test_a_turned_thing_looks_the_same_from_a_turned_place():
    before = scene()
    after = edits.turned(before, CHOSEN, 90)
    angle = torch.tensor([math.cos(math.pi / 4), 0, math.sin(math.pi / 4), 0])
    rotation = quats_to_matrices(angle)
    own = covariances(before.scales, before.quats)[0, CHOSEN]
    torch.testing.assert_close(
        covariances(after.scales, after.quats)[0, CHOSEN],
        rotation @ own @ rotation.T,
        rtol=0,
        atol=1e-5,
    )
    directions = torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    shown = basis(directions, 3) @ before.harmonics[0, CHOSEN]
    torch.testing.assert_close(
        basis(directions @ rotation.T, 3) @ after.harmonics[0, CHOSEN],
        shown,
        rtol=0,
        atol=1e-4,
    )


def test_a_scaled_thing_grows_and_keeps_standing():
    before = scene()
    after = edits.scaled(before, CHOSEN, 3)
    low, high = (g.means[0, CHOSEN, 1].quantile(edits.FOOT) for g in (before, after))
    torch.testing.assert_close(low, high, rtol=0, atol=1e-4)
    spread = after.means[0, CHOSEN].std(0) / before.means[0, CHOSEN].std(0)
    torch.testing.assert_close(spread, torch.full((3,), 3.0), rtol=1e-4, atol=0)
    torch.testing.assert_close(after.scales[:, CHOSEN], 3 * before.scales[:, CHOSEN])


def test_paint_keeps_the_order_of_light_and_dark():
    after = recoloured(scene(), CHOSEN)
    colours = dc_to_colour(after.harmonics[0, CHOSEN, 0])
    assert (colours[:, 2] > colours[:, 0]).all()
    assert (colours.sum(1).diff() > 0).all()
    higher = after.harmonics[0, CHOSEN, 1:]
    assert (higher == higher[..., :1]).all()


def test_a_told_up_comes_before_how_the_photos_were_held():
    """Both cameras of the upright scene look down; a thing still moves straight up."""
    look_down = torch.eye(4).repeat(1, 2, 1, 1)
    look_down[:, :, 1:3, 1:3] = torch.tensor([[0.8, 0.6], [-0.6, 0.8]])
    lens = torch.eye(3).expand(1, 2, 3, 3)
    before, up = scene(), torch.tensor([0.0, -1, 0])
    cameras = Cameras(look_down, lens, (4, 4))

    def raised(up):
        lift = lambda one: edits.moved(one, CHOSEN, (0.0, 0.2, 0.0))  # noqa: E731
        after = edits.in_view_0(before, CHOSEN, cameras, up, lift)
        return (after.means - before.select(CHOSEN).means)[0, 0]

    depth = before.means[0, :, 2].median()
    expected = -0.2 * depth * torch.tensor([0.0, 1, 0])
    torch.testing.assert_close(raised(up), expected, rtol=0, atol=1e-5)
    assert abs(raised(None)[2]) > 0.1
