"""What is drawn over a scene chooses what it covers, not what lies behind."""

from dataclasses import replace

import pytest
import torch
from edit3r_objects.drawn import Drawn, choose_drawn, read_drawn

from edit3r import build
from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians

SIZE = 48, 72
VIEW = {
    "right": (1, 0, 0),
    "down": (0, 1, 0),
    "forward": (0, 0, 1),
    "centre": (0, 0, 0),
    "lens": (0.9, 1.35, 0.5, 0.5),
    "aspect": 1.5,
}
LEFT = [(0, 0), (0.5, 0), (0.5, 1), (0, 1)]


@pytest.fixture(scope="module")
def scene():
    """A red left and a blue right half, and a wall behind them; which Gaussians are which."""
    lens = torch.tensor([[0.9, 0, 0.5], [0, 1.35, 0.5], [0, 0, 1]])[None, None]
    camera = Cameras(torch.eye(4)[None, None], lens, SIZE)
    image = torch.zeros(1, 1, 3, *SIZE)
    image[:, :, 0, :, :36] = 1
    image[:, :, 2, :, 36:] = 1
    parts = []
    for depth in (2.0, 5.0):
        depths = torch.full((1, 1, *SIZE), depth)
        scales = pixel_scales(depths, camera.intrinsics, 0.7)
        full = torch.full_like(depths, 0.95)
        parts.append(pixels_to_gaussians(image, depths, camera, scales, full))
    gaussians = type(parts[0]).cat(parts)
    return gaussians, gaussians.means[0, :, 2] < 3, gaussians.means[0, :, 0] < 0


def chosen(scene, *strokes, **more):
    found = read_drawn([{**VIEW, **stroke} for stroke in strokes])
    return choose_drawn(scene[0], found, build("rasterizer", "auto"), **more)


def overlap(one, other):
    return float((one & other).sum() / (one | other).sum())


def test_a_lasso_takes_the_surface_and_nothing_behind_it(scene):
    _, front, left = scene
    taken = chosen(scene, {"kind": "lasso", "places": LEFT})
    assert overlap(taken, front & left) > 0.9


def test_a_lasso_that_strays_ends_where_the_thing_does(scene):
    _, front, left = scene
    stray = [(0, 0), (0.516, 0), (0.516, 1), (0, 1)]
    assert (
        overlap(chosen(scene, {"kind": "lasso", "places": stray}), front & left) > 0.98
    )


def test_a_brush_that_strays_ends_where_the_thing_does(scene):
    _, front, left = scene
    strays = [
        {"kind": "brush", "places": [(0, y), (0.4085, y)], "radius": 0.1}
        for y in torch.arange(0, 1.01, 0.05).tolist()
    ]
    assert overlap(chosen(scene, *strays), front & left) > 0.98


def test_two_strokes_leave_no_seam(scene):
    _, front, _ = scene
    beside = [
        {"kind": "brush", "places": [(0, y), (1, y)], "radius": 0.005}
        for y in torch.arange(0, 1.01, 5 / 256).tolist()
    ]
    assert overlap(chosen(scene, *beside), front) > 0.95


def test_what_reaches_back_is_taken_whole():
    """A floor from 1 to 10 before the camera, behind a bar that one can see through."""
    lens = torch.tensor([[0.9, 0, 0.5], [0, 1.35, 0.5], [0, 0, 1]])[None, None]
    camera = Cameras(torch.eye(4)[None, None], lens, SIZE)
    floor = torch.linspace(10, 1, SIZE[0])[:, None].expand(SIZE)[None, None]
    bar = torch.full_like(floor, 1.0)
    parts = []
    for depths, opacity in ((floor, 0.95), (bar, 0.6)):
        scales = pixel_scales(depths, camera.intrinsics, 0.7)
        image, full = torch.ones(1, 1, 3, *SIZE), torch.full_like(depths, opacity)
        parts.append(pixels_to_gaussians(image, depths, camera, scales, full))
    middle = torch.arange(SIZE[1] * 24, SIZE[1] * 32)
    gaussians = type(parts[0]).cat([parts[0], parts[1].select(middle)])
    taken = chosen(
        (gaussians,), {"kind": "lasso", "places": [(0, 0), (1, 0), (1, 1), (0, 1)]}
    )
    assert taken.all()


def test_strokes_add_and_take_away_in_order(scene):
    _, front, left = scene
    whole = {"kind": "brush", "places": [(0, 0.5), (1, 0.5)], "radius": 0.5}
    away = {"kind": "lasso", "places": LEFT, "minus": True}
    assert overlap(chosen(scene, whole, away), front & ~left) > 0.85
    assert overlap(chosen(scene, away, whole), front) > 0.9


def test_growing_takes_in_what_lies_around_and_shrinking_leaves_it(scene):
    stroke = {
        "kind": "lasso",
        "places": [(0.2, 0.3), (0.4, 0.3), (0.4, 0.7), (0.2, 0.7)],
    }
    plain, more, less = (chosen(scene, stroke, grown=n) for n in (0, 1, -1))
    assert (plain & ~more).sum() == (less & ~plain).sum() == 0
    assert more.sum() > plain.sum() > less.sum() > 0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"kind": "pencil"}, "kind"),
        ({"places": []}, "places"),
        ({"places": [(float("nan"), 0)]}, "places"),
        ({"right": (0, 0, 1)}, "not a camera"),
        ({"lens": (0, 1, 0.5, 0.5)}, "not a camera"),
    ],
)
def test_what_is_no_stroke_is_refused(scene, change, told):
    with pytest.raises(InputError, match=told):
        chosen(scene, {"kind": "lasso", "places": LEFT, **change})
    stroke = {"kind": "lasso", "places": LEFT, **VIEW}
    for count in (0, 201):
        with pytest.raises(InputError, match=f"1 to 200 strokes, got {count}"):
            read_drawn([stroke] * count)


def test_the_picture_has_the_shape_of_the_window():
    wide = Drawn("brush", [(0.5, 0.5)], **VIEW)
    tall = replace(wide, aspect=0.5)
    assert wide.size == (256, 384) and tall.size == (384, 192)
    assert wide.mask.sum() > 0
