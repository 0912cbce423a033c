"""How well a scene, its geometry and one flat picture lay a photo onto its neighbour."""

from dataclasses import replace

import pytest
import torch
from edit3r_judge import skill
from edit3r_judge.signals import unlike_between
from edit3r_judge.skill import (
    FLOOR,
    Skill,
    _as_places,
    _depths_of,
    skills,
    unchanged,
)

from edit3r.contract.interfaces import SceneToJudge
from edit3r.contract.interfaces.judging import HalfWay
from edit3r.contract.types import Cameras, Rendering
from edit3r_testing import gaussian_cloud
from edit3r_testing.broken import BrokenReconstructor
from edit3r_testing.scenes import photograph, true_geometry

SIZE = (192, 256)


def scene():
    """A scene of the true depths, judged by photos of two balls before a wall."""
    taken = photograph(2, SIZE)
    geometry = true_geometry(taken.views)
    made = BrokenReconstructor()(taken.views, geometry=geometry)
    shown = Rendering(
        taken.views.images,
        torch.ones(1, 2, 1, *SIZE),
        geometry.depths[:, :, None],
    )
    half_way = HalfWay(shown, made.cameras, ((0, 1),))
    views = taken.views
    return SceneToJudge(
        views,
        (True, True),
        geometry,
        views,
        made.cameras,
        made.gaussians,
        shown,
        shown,
        None,
        half_way=half_way,
    )


def test_one_flat_picture_explains_a_neighbour_worse_than_depth_from_either_side():
    """What two photos share is searched for once: the other way round it is the same pairs."""
    both = skills(scene())
    assert [one.view for one in both] == [0, 1]
    for one in both:
        assert one.scene < FLOOR + 1 and one.geometry < FLOOR + 1
        assert one.flat > one.geometry
    assert both[0].flat == pytest.approx(both[1].flat, rel=0.4)


def test_a_photo_taken_darker_is_the_same_place_in_one_light():
    plain = scene()
    images = plain.photos.images.clone()
    images[:, 1] *= 0.5
    darker = replace(plain.photos, images=images)
    for one, as_bright in zip(
        skills(replace(plain, photos=darker, edited=darker)), skills(plain)
    ):
        assert one.beside_flat == pytest.approx(as_bright.beside_flat, abs=0.1)
        assert one.geometry < FLOOR + 2


def test_what_no_photo_shows_half_way_is_asked_of_the_places_that_are_named():
    plain = scene()
    images = plain.photos.images[:, :1].clone()
    images[..., :128] = torch.rand(3, 192, 128, generator=torch.Generator())
    shown = replace(plain.half_way.rendered, images=images)
    spoilt = replace(plain, half_way=replace(plain.half_way, rendered=shown))
    right = torch.zeros(2, *SIZE, dtype=torch.bool)
    right[..., 140:] = True
    assert max(unlike_between(spoilt)) > 0.3
    assert max(unlike_between(spoilt, right)) < 0.1
    images = torch.cat((images, plain.photos.images[:, 1:]), 1)
    kept = unchanged(replace(plain, edited=replace(plain.edited, images=images)))
    assert kept[1].all() and kept[0, :, 128:].all()
    assert kept[0, :, :128].float().mean() < 0.1


def test_what_stands_in_place_of_a_large_removed_thing_is_no_depth_of_the_photos():
    """Seven tenths of the photos are removed, and what replaces them lies three times as far."""
    plain = scene()
    column = torch.arange(SIZE[1]).expand(SIZE)
    gone = column < 0.7 * SIZE[1]
    images = torch.where(gone, 0.0, plain.photos.images)
    pixel = gone.flatten().repeat(2)
    means = torch.where(
        pixel[:, None], 3 * plain.gaussians.means, plain.gaussians.means
    )
    made = replace(
        plain,
        edited=replace(plain.edited, images=images),
        gaussians=replace(plain.gaussians, means=means),
    )
    assert all(one.beside_geometry < 1.1 for one in skills(made))


def test_where_an_edit_leaves_a_wall_alone_to_compare_no_depth_is_missed():
    """What stands before the wall is painted: one flat picture explains all the rest."""
    plain, balls = scene(), photograph(2, SIZE).objects.amax(0)[:, :, None]
    assert 0.1 < balls.mean() < 0.4
    painted = torch.where(balls > 0, 0.0, plain.photos.images)
    made = replace(plain, edited=replace(plain.edited, images=painted))
    assert [one.flat for one in skills(made)] == [None, None]


@pytest.mark.parametrize(
    ("opacities", "depth"), [((0.9, 0.9), 1), ((0.9, 0.1), 0), ((0.1, 0.9), 1)]
)
def test_where_one_sees_through_what_is_in_front_no_surface_is_known(opacities, depth):
    """Of a photo whose Gaussians are faint, others show it: what is behind them is no depth."""
    two = gaussian_cloud(2)
    means = torch.tensor([[[0.0, 0, 2], [0, 0, 1]]])
    seen = replace(two, means=means, opacities=torch.tensor([opacities]))
    lens = torch.tensor([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])[None, None]
    depths = _depths_of(seen, Cameras(torch.eye(4)[None, None], lens, (8, 8)), 0)
    assert depths.max() == depth


@pytest.mark.parametrize(("count", "asked"), [(1, 1), (8, 8), (9, 8), (40, 8)])
def test_of_many_photos_evenly_chosen_pairs_are_compared(monkeypatch, count, asked):
    compared = []

    class Photos:
        def __init__(self, scene):
            pass

        def skill(self, view, other):
            compared.append((view, other))

    monkeypatch.setattr(skill, "_Photos", Photos)
    judged = scene()
    pairs = tuple((view, view + 1) for view in range(count))
    skills(replace(judged, half_way=replace(judged.half_way, pairs=pairs)))
    assert len(compared) == 2 * asked
    assert max(map(max, compared)) >= count - count // asked


@pytest.mark.parametrize(
    ("left", "flat", "figure"),
    [
        (1.2, 1.5, None),  # a dark picture, or hardly a step aside: both explain it
        (2.2, 2.4, None),
        (9.0, 1.5, 4.5),  # wrong depths are told all the same
        (1.2, 8.0, 0.25),
    ],
)
def test_where_noise_explains_what_either_leaves_nobody_tells_a_flat_picture(
    left, flat, figure
):
    assert Skill(0, left, left, flat).beside_flat == figure


def test_the_middle_of_the_first_pixel_lies_at_a_half():
    """OpenCV counts pixels from their middles, the project from their corners."""
    assert _as_places([(0, 0), (3, 1)]).tolist() == [[0.5, 0.5], [3.5, 1.5]]
    assert _as_places([]).shape == (0, 2)
