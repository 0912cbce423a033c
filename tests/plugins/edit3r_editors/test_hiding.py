"""The looks that hide: how little they leave of a region."""

import pytest
import torch
from edit3r_editors.hiding import LEAST, VALUES, blurred, pixelated

from edit3r.contract.errors import PromptError
from edit3r.loading.registry import build
from edit3r.running.editors import read


def noise(views=1, side=120):
    return torch.rand(views, 3, side, side, generator=torch.Generator().manual_seed(0))


def disc(views=1, side=120, radius=40):
    away = torch.arange(side) - side / 2
    inside = away[:, None] ** 2 + away[None] ** 2 < radius**2
    return inside.expand(views, side, side)


@pytest.mark.parametrize("views", [1, 2, 5, 100])
def test_all_photos_together_leave_few_colours_of_a_thing(views):
    where = disc(views)
    drawn = pixelated(noise(views), where)
    colours = [one[:, inside].T.unique(dim=0) for one, inside in zip(drawn, where)]
    assert 0 < sum(map(len, colours)) <= max(VALUES, views)


@pytest.mark.parametrize("draw", [blurred, pixelated])
def test_what_differs_in_the_photo_and_has_the_same_means_is_drawn_alike(draw):
    """Nothing but the means goes on, so nothing else can come back."""
    where, image = disc(radius=60), torch.full((1, 3, 120, 120), 0.5)
    fine = image.clone()
    checked = (torch.arange(120)[:, None] + torch.arange(120)) % 2
    fine += 0.4 * (2 * checked - 1)
    apart = (draw(fine, where) - draw(image, where)).abs()
    assert apart[:, :, where[0]].max() < 0.05


@pytest.mark.parametrize("draw", [blurred, pixelated])
def test_a_thing_of_few_pixels_becomes_one_colour(draw):
    where = torch.zeros(1, 120, 120, dtype=torch.bool)
    where[:, 50 : 50 + LEAST, 60 : 60 + LEAST] = True
    inside = draw(noise(), where)[:, :, where[0]]
    assert (inside - inside[..., :1]).abs().max() < 1e-6


@pytest.mark.parametrize("draw", [blurred, pixelated])
def test_a_thing_is_drawn_by_itself_and_all_else_stays(draw):
    image, where = noise(), disc(radius=20)
    other = where | (torch.arange(120) > 100)
    drawn = draw(image, where)
    assert torch.equal(drawn[:, :, ~where[0]], image[:, :, ~where[0]])
    assert torch.equal(drawn[:, :, where[0]], draw(image, other)[:, :, where[0]])


def test_half_of_it_is_refused():
    (instruction,) = read("blur the faces")
    assert build("editor", "looks").hides(instruction)
    with pytest.raises(PromptError, match=r"hides wholly.*strength is 0\.5; leave it"):
        build("editor", "looks", strength=0.5).hides(instruction)
    (other,) = read("the face as a sketch")
    assert not build("editor", "looks", strength=0.5).hides(other)
