"""Places around a scene and within it, which way is up, and pictures from there."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.scenes.axes import rotated
from edit3r.kit.scenes.scene_views import (
    BACKGROUND,
    as_given,
    look_around,
    pictures_of,
    up_of,
)
from tests.plugins.scan import scan

SIZE = (40, 40)


@pytest.fixture(scope="module")
def rasterizer():
    return edit3r.build("rasterizer", "numba")


def room(count=40):
    """A box of 4 x 2 x 4 around the origin, seen from inside."""
    side = torch.linspace(-1, 1, count)
    flat = torch.cartesian_prod(side, side)
    walls = []
    for axis, half in ((0, 2.0), (1, 1.0), (2, 2.0)):
        for sign in (-1, 1):
            place = torch.zeros(len(flat), 3)
            others = [one for one in range(3) if one != axis]
            halves = torch.tensor([2.0, 1.0, 2.0])
            place[:, others] = flat * halves[others]
            place[:, axis] = sign * half
            walls.append(place)
    means = torch.cat(walls)
    quats = torch.zeros(len(means), 4)
    quats[:, 0] = 1
    return Gaussians(
        means[None],
        torch.full((1, len(means), 3), 0.08),
        quats[None],
        torch.full((1, len(means)), 0.95),
        colour_to_dc(torch.full((1, len(means), 1, 3), 0.4)),
    )


def test_places_stand_around_a_thing_and_see_all_of_it(rasterizer):
    places = look_around(scan(), rasterizer, count=6, size=SIZE)
    assert places.how == "around"
    for view in range(6):
        lens, pose = places.cameras.intrinsics[0, view], places.cameras.c2w[0, view]
        where, depth = project(scan().means[0], lens, pose)
        assert (depth > 0).all()
        assert ((where > 0) & (where < 1)).all(1).float().mean() > 0.97
    away = places.cameras.c2w[0, :, :3, 3]
    assert torch.pdist(away).min() > 0.5


def test_a_room_is_looked_at_from_within(rasterizer):
    places = look_around(room(), rasterizer, count=4, size=SIZE)
    assert places.how == "within"
    assert places.cameras.c2w[0, :, :3, 3].norm(dim=1).max() < 0.5


def test_up_is_away_from_the_floor_whichever_way_the_scene_lies():
    standing = scan()
    assert up_of(standing) == (0, -1, 0)
    quarter = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert torch.allclose(
        torch.tensor(up_of(rotated(standing, quarter))),
        quarter @ torch.tensor([0, -1.0, 0]),
    )


def test_up_is_as_asked(rasterizer):
    places = look_around(scan(), rasterizer, count=2, size=SIZE, up="+z")
    assert places.up == (0, 0, 1)
    down = places.cameras.c2w[0, 0, :3, 1]
    assert float(down[2]) < -0.9


def test_pictures_are_in_the_frame_of_view_0_and_depths_are_the_scenes(rasterizer):
    large = replace(scan(), means=40 * scan().means, scales=40 * scan().scales)
    places = look_around(large, rasterizer, count=3, size=SIZE)
    seen = pictures_of(large, places, rasterizer)
    scene = seen.scene
    assert torch.equal(scene.cameras.c2w[0, 0], torch.eye(4))
    assert 0.5 <= float(scene.depths[scene.alphas > 0.9].median()) <= 2
    # A point of a picture lies on the scene, once it is back in the scene's own frame.
    points = unproject(
        scene.depths[0, 1], scene.cameras.intrinsics[0, 1], scene.cameras.c2w[0, 1]
    )[scene.alphas[0, 1] > 0.99]
    own = seen.unit * points @ seen.c2w[:3, :3].T + seen.c2w[:3, 3]
    nearest = torch.cdist(own, large.means[0]).amin(1)
    assert float(nearest.quantile(0.9)) < 40 * 0.15


def test_what_is_empty_in_a_picture_is_background_and_not_black(rasterizer):
    seen = pictures_of(
        scan(), look_around(scan(), rasterizer, count=2, size=SIZE), rasterizer
    )
    empty = seen.scene.alphas[0, 0] == 0
    assert empty.any()
    assert (seen.pictures.images[0, 0][:, empty] == BACKGROUND).all()


def test_cameras_that_look_elsewhere_are_refused(rasterizer):
    places = look_around(scan(), rasterizer, count=1, size=SIZE)
    away = places.cameras.c2w.clone()
    away[..., :3, 2] *= -1
    away[..., :3, 0] *= -1
    with pytest.raises(InputError, match="nothing of the scene is seen"):
        pictures_of(
            scan(), as_given(replace(places.cameras, c2w=away), ["a"]), rasterizer
        )


def test_a_scene_of_one_point_is_refused(rasterizer):
    point = scan().select(torch.tensor([0]))
    with pytest.raises(InputError, match="single point"):
        look_around(point, rasterizer, count=2, size=SIZE)


def test_places_around_a_thing_stand_low_and_high_by_turns(rasterizer):
    places = look_around(scan(), rasterizer, count=6, size=SIZE)
    heights = places.cameras.c2w[0, :, :3, 3] @ torch.tensor(places.up)
    assert heights[::2].max() < heights[1::2].min() - 0.2


def test_a_floor_with_as_large_a_ceiling_tells_no_up():
    box = room()  # each of its sides has a sixth of the area
    assert up_of(replace(box, scales=box.scales * torch.tensor([0.1, 1, 1]))) == (
        0,
        -1,
        0,
    )
