"""The shares that rest on one photo, and the views of the sheet."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from edit3r_uncertainty.run import JudgedRun, coloured, judge, with_halfway

from edit3r import build

from .scenes import eyes, wall


@pytest.fixture(scope="module")
def run():
    """A wall in two photos; the edit painted the outer quarter of the first, shown by it alone."""
    scene = wall(2.0)
    photos = build("rasterizer", "auto").render(scene, eyes()).images[0].clamp(0, 1)
    edited = photos.clone()
    edited[0, :, :, :8] = 0
    return JudgedRun(Path(), scene, eyes(), ("left", "right"), photos, edited, {})


def test_shares_on_one_photo_are_those_of_the_outer_edges_and_of_the_edit(run):
    judged = judge(run, build("rasterizer", "auto"))
    # Each photo shows 1 unit in x at a depth of 2, and the two of them overlap by a half.
    assert judged.facts["one_photo"] == pytest.approx(0.5, abs=0.08)
    assert judged.facts["edit_one_photo"] == pytest.approx(1, abs=0.02)
    assert judged.gaussians.uncertainty.shape == (1, run.gaussians.count)
    assert "(100% of what the edit changed)" in judged.sentence


def test_between_two_photos_is_a_view_half_way(run):
    cameras, names = with_halfway(run)
    assert names == ["left", "between_0_1", "right"]
    places = cameras.c2w[0, :, 0, 3]
    torch.testing.assert_close(places, torch.tensor([-0.5, 0.0, 0.5]))


def test_a_photo_that_is_called_like_a_view_between_keeps_a_file_of_its_own(run):
    _, names = with_halfway(replace(run, names=("between_0_1", "right")))
    assert len(set(names)) == 3


def test_uncertain_places_are_brighter():
    shown = coloured(torch.linspace(0, 1, 12).view(1, 1, 12))
    assert shown.shape == (1, 3, 1, 12)
    assert (shown.mean(1).diff() > 0).all()
