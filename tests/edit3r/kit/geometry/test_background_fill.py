"""The layers around the images and behind their depth edges, in a scene whose geometry is known."""

import dataclasses

import pytest
import torch

from edit3r.contract.interfaces import Geometry
from edit3r.kit.geometry.background_fill import background_layer, rim
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r_testing import photograph


@pytest.fixture(scope="module")
def pair():
    return photograph(2, (96, 128))


@pytest.fixture
def truth(pair):
    confidence = torch.ones_like(pair.depths)
    return Geometry(
        pair.cameras.c2w, pair.depths, confidence, torch.ones(1, 2, dtype=torch.bool)
    )


def test_the_rim_stays_out_of_every_photo(pair, truth):
    made = rim(pair.views, truth, 0.2, 0.6)
    assert made.count > 100
    for view in (0, 1):
        places, depth = project(
            made.means, pair.views.intrinsics[:, view], truth.c2w[:, view]
        )
        shown = ((places > 0) & (places < 1)).all(-1) & (depth > 0)
        assert not shown.any()


def test_the_rim_fades_outwards_to_nothing(pair, truth):
    made = rim(
        pair.views.select([0]), dataclasses.replace(truth, **_first(truth)), 0.2, 0.6
    )
    places, _ = project(made.means, pair.views.intrinsics[:, 0], truth.c2w[:, 0])
    height, width = pair.views.image_size
    beyond = (torch.maximum(-places, places - 1) * torch.tensor([width, height])).amax(
        -1
    )[0]
    near, far = (
        made.opacities[0][part]
        for part in (beyond < beyond.quantile(0.2), beyond > beyond.quantile(0.8))
    )
    assert near.min() > far.max() and far.min() < 0.15 and near.max() > 0.5


def _first(truth):
    return {
        name: getattr(truth, name)[:, :1]
        for name in ("c2w", "depths", "confidence", "registered")
    }


def test_the_rim_of_a_grey_photo_is_grey(pair, truth):
    grey = dataclasses.replace(
        pair.views, images=torch.full_like(pair.views.images, 0.25)
    )
    made = rim(grey, truth, 0.1, 0.6)
    assert torch.allclose(dc_to_colour(made.harmonics), torch.tensor(0.25), atol=1e-6)


def test_a_line_on_the_border_becomes_no_stripe_of_the_rim(pair, truth):
    images = torch.zeros_like(pair.views.images)
    images[..., 60:68] = 1  # a white line from top to bottom
    lined = dataclasses.replace(pair.views, images=images).select([0])
    made = rim(lined, dataclasses.replace(truth, **_first(truth)), 0.3, 0.6)
    places, _ = project(made.means, lined.intrinsics[:, 0], truth.c2w[:, 0])
    white = dc_to_colour(made.harmonics)[0, :, 0, 0]
    above, middle = places[0, :, 1] < 0, (places[0, :, 0] - 0.5).abs() < 0.05
    beside = white[above & middle & (places[0, :, 1] > -0.05)].max()
    far = white[above & middle & (places[0, :, 1] < -0.2)].max()
    assert beside > 0.5 and 0 < far < beside / 2


def test_no_layer_stands_before_a_photo(pair, truth):
    layer = background_layer(pair.views, truth, 0.9)
    assert layer.count > 50
    height, width = pair.views.image_size
    for view in (0, 1):
        places, depth = project(
            layer.means, pair.views.intrinsics[:, view], truth.c2w[:, view]
        )
        pixel = (places[0] * torch.tensor([width, height])).floor().long()
        inside = (
            ((places[0] > 0) & (places[0] < 1)).all(-1)
            & (depth[0] > 0)
            & (layer.view_index != view)
        )
        surface = truth.depths[0, view][pixel[inside, 1], pixel[inside, 0]]
        assert (depth[0][inside] >= surface * (1 - 1e-4)).all()


def test_a_flat_measured_wall_needs_no_background_layer(pair, truth):
    wall = dataclasses.replace(truth, depths=torch.full_like(truth.depths, 3.0))
    assert background_layer(pair.views, wall, 0.9).count == 0
    guessed = dataclasses.replace(wall, confidence=torch.zeros_like(wall.confidence))
    assert background_layer(pair.views, guessed, 0.9).count > 0


def test_a_view_that_was_not_placed_has_no_background_layer(pair, truth):
    first = dataclasses.replace(truth, registered=torch.tensor([[True, False]]))
    assert set(background_layer(pair.views, first, 0.9).view_index.tolist()) == {0}


def test_behind_an_edge_the_surface_beside_it_goes_on_in_its_own_colour(pair, truth):
    """A box before a wall that is red on the left and blue on the right."""
    height, width = pair.views.image_size
    images = torch.zeros_like(pair.views.images)
    images[:, :, 0, :, : width // 2] = 1
    images[:, :, 2, :, width // 2 :] = 1
    depths = torch.full_like(truth.depths, 4.0)
    box = slice(height // 4, 3 * height // 4), slice(width // 4, 3 * width // 4)
    depths[..., box[0], box[1]] = 2
    images[..., box[0], box[1]] = 0.5
    views = dataclasses.replace(pair.views, images=images).select([0])
    one = _first(truth) | {"depths": depths[:, :1]}
    boxed = dataclasses.replace(truth, **one)
    layer = background_layer(views, boxed, 0.9)
    places, z = project(layer.means, views.intrinsics[:, 0], truth.c2w[:, 0])
    colour = dc_to_colour(layer.harmonics)[0, :, 0]
    size = layer.scales[0].amax(-1) / z[0]
    fine = size < (size.min() + size.max()) / 2  # beside the edge, not far behind
    x = places[0, :, 0]
    left, right = fine & (x < 0.35), fine & (x > 0.65)
    assert left.sum() > 5 and right.sum() > 5
    assert torch.allclose(z[0, left | right], torch.tensor(4.0), rtol=1e-3)
    assert torch.allclose(colour[left], torch.tensor([1.0, 0, 0]), atol=1e-4)
    assert torch.allclose(colour[right], torch.tensor([0, 0, 1.0]), atol=1e-4)
