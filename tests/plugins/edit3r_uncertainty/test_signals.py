"""The number of each Gaussian on a wall that two cameras look at, and its formula."""

import pytest
import torch
from edit3r_uncertainty.signals import SIGNALS, photos_of, probability, uncertainty

from edit3r import Gaussians, build

from .scenes import eyes, wall


@pytest.fixture(scope="module")
def judged():
    """A wall that both photos show, the sides that one shows, and a wall hidden behind it."""
    front = wall(2.0)
    scene = Gaussians.cat([front, wall(6.0)])
    rasterizer = build("rasterizer", "auto")
    photos = rasterizer.render(front, eyes()).images[0].clamp(0, 1)
    number, shown = uncertainty(scene, eyes(), photos, rasterizer)
    return number[0], photos_of(shown), scene, photos


def test_two_photos_are_surer_than_one_and_one_than_none(judged):
    number, photos, _, _ = judged
    means = [number[photos == count].mean() for count in (2, 1, 0)]
    assert 2 * means[0] < means[1] < means[2] == 1
    assert number.min() > 0 and number.max() <= 1


def test_what_the_photos_deny_is_uncertain(judged):
    number, photos, scene, images = judged
    denied = images.clone()
    denied[:, :, :16] = 1 - denied[:, :, :16]
    again, _ = uncertainty(scene, eyes(), denied, build("rasterizer", "auto"))
    above = (scene.means[0, :, 1] < -0.2) & (photos == 2)
    below = (scene.means[0, :, 1] > 0.2) & (photos == 2)
    assert again[0, above].mean() > number[above].mean() + 0.2
    torch.testing.assert_close(again[0, below], number[below], atol=0.02, rtol=0)


@pytest.mark.parametrize(
    ("signal", "direction"),
    [
        ("contrast", 1),
        ("misfit", 1),
        ("opacity", -1),
        ("others", -1),
        ("photos", -1),
    ],
)
def test_each_signal_pulls_in_its_own_direction(signal, direction):
    signals = torch.zeros(5, len(SIGNALS))
    signals[:, list(SIGNALS).index(signal)] = torch.linspace(-1, 1, 5)
    factors = torch.tensor(list(SIGNALS.values()))
    number = probability(signals, torch.ones(1, 5), factors, 0.0)[0]
    assert (number.diff() * direction > 0).all()
