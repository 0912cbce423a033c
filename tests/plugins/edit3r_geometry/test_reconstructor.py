import dataclasses

import pytest
import torch
from edit3r_geometry.reconstructor import seen_by_others
from edit3r_measure.novel_view import best_blurred_copy

import edit3r
from edit3r import Cameras, Views
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r.kit.compute.metrics import psnr
from edit3r.kit.geometry.background_fill import background_layer
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.warping import contradicted
from edit3r.kit.reconstructing import WithMatcher


class KnownGeometry(Matcher):
    """Stands in for a matcher where a test knows the truth."""

    def __init__(self, geometry):
        self.geometry = geometry
        self.asked = None

    def match(self, views):
        self.asked = views
        return self.geometry


@pytest.fixture
def truth(pair):
    depths = torch.from_numpy(pair.depths).float()[None]
    return Geometry(
        torch.from_numpy(pair.c2w).float()[None],
        depths,
        torch.ones_like(depths),
        torch.ones(1, 2, dtype=torch.bool),
    )


def build(geometry, **settings):
    built = edit3r.build("reconstructor", "classical", **settings)
    return WithMatcher(built, KnownGeometry(geometry))


def by_matching(pair_of_photos):
    matcher = edit3r.build("matcher", "classical")
    return WithMatcher(edit3r.build("reconstructor", "classical"), matcher)(
        pair_of_photos
    )


def test_every_pixel_becomes_a_gaussian_of_its_own_colour_and_view(pair, truth):
    gaussians = build(truth, rim=0, background_layer=0)(pair.views).gaussians
    height, width = pair.views.image_size
    assert gaussians.count == 2 * height * width
    assert (
        gaussians.view_index == torch.arange(2).repeat_interleave(height * width)
    ).all()
    colours = dc_to_colour(gaussians.harmonics[0, :, 0]).view(2, height, width, 3)
    photos = pair.views.images[0].movedim(1, -1)
    assert torch.allclose(colours, photos, atol=1e-6)


def test_gaussians_stand_where_their_pixels_see_them(pair, truth):
    made = build(truth, rim=0, background_layer=0)(pair.views)
    means = made.gaussians.from_view(1).means
    places, depth = project(means, pair.views.intrinsics[:, 1], truth.c2w[:, 1])
    height, width = pair.views.image_size
    corner = torch.tensor([0.5 / width, 0.5 / height])
    assert torch.allclose(places[0, 0], corner, atol=1e-5)
    assert torch.allclose(depth.view(height, width), truth.depths[0, 1], rtol=1e-4)


def test_geometry_comes_from_the_source_and_colours_from_the_edit(pair, truth):
    edited = dataclasses.replace(pair.views, images=1 - pair.views.images)
    reconstructor = build(truth, rim=0, background_layer=0)
    plain, other = reconstructor(pair.views), reconstructor(edited, source=pair.views)
    assert torch.equal(plain.gaussians.means, other.gaussians.means)
    assert torch.allclose(
        plain.gaussians.harmonics, -other.gaussians.harmonics, atol=1e-5
    )


@pytest.mark.slow
def test_rendering_from_the_middle_shows_what_a_camera_there_sees(
    pair, truth, make_room
):
    between = make_room([(0,), (0.2, 0.025, -2.5)])
    gaussians = build(truth)(pair.views).gaussians
    cameras = Cameras(
        torch.from_numpy(between.c2w[1:]).float()[None],
        between.views.intrinsics[:, 1:],
        pair.views.image_size,
    )
    seen = edit3r.build("rasterizer", "numba").render(gaussians, cameras)
    image, wanted, *photos = (
        picture.permute(1, 2, 0).numpy()
        for picture in (
            seen.images[0, 0],
            between.views.images[0, 1],
            *pair.views.images[0],
        )
    )
    assert psnr(image, wanted) > best_blurred_copy(photos, wanted)[0] + 4
    assert (seen.alphas > 0.5).float().mean() > 0.97


def test_guessed_pixels_are_less_opaque(pair, truth):
    half = truth.confidence.clone()
    half[..., :40] = 0
    geometry = dataclasses.replace(truth, confidence=half)
    settings = build(geometry).reconstructor.settings
    made = build(geometry, rim=0, background_layer=0)(pair.views)
    opacities = made.gaussians.opacities
    expected = [settings.guessed_opacity, settings.opacity, settings.lone_opacity]
    assert opacities.unique().tolist() == pytest.approx(expected)
    shown = seen_by_others(geometry, pair.views.intrinsics)
    kept = ~contradicted(geometry, pair.views.intrinsics)
    guessed = opacities[0][(shown & (half == 0))[kept]].unique()
    assert guessed.tolist() == pytest.approx(expected[:1])


def test_a_guess_before_what_the_other_view_saw_is_dropped(pair, truth):
    depths, confidence = truth.depths.clone(), truth.confidence.clone()
    depths[0, 0, 60:64, 80:84] = 0.5 * depths[0, 0, 60:64, 80:84]
    confidence[0, 0, 60:64, 80:84] = 0
    geometry = dataclasses.replace(truth, depths=depths, confidence=confidence)
    floating = contradicted(geometry, pair.views.intrinsics)
    assert floating[0, 0, 60:64, 80:84].all()
    assert floating.sum() == 16
    made = build(geometry, rim=0, background_layer=0)(pair.views)
    assert made.gaussians.count == truth.depths.numel() - 16


def test_views_that_were_not_placed_leave_no_gaussians(pair, truth):
    three = [0, 1, 1]
    placed = torch.tensor([[True, False, True]])
    geometry = dataclasses.replace(truth.select(three), registered=placed)
    gaussians = build(geometry)(pair.views.select(three)).gaussians
    assert set(gaussians.view_index.tolist()) == {0, 2}


def test_predicted_cameras_are_those_of_the_photos(pair, truth):
    cameras = build(truth)(pair.views).cameras
    assert torch.equal(cameras.c2w, truth.c2w)
    assert torch.equal(cameras.intrinsics, pair.views.intrinsics)
    assert cameras.image_size == pair.views.image_size


def test_photos_that_cannot_be_matched_raise():
    views = Views(torch.full((1, 2, 3, 64, 64), 0.5), torch.eye(3).expand(1, 2, 3, 3))
    with pytest.raises(MatchingError):
        by_matching(views)


@pytest.mark.slow
def test_photos_alone_give_a_scene_that_shows_them_again(pair):
    made, numba = by_matching(pair.views), edit3r.build("rasterizer", "numba")
    seen = numba.render(made.gaussians, made.cameras)
    for view in (0, 1):
        image, photo = (
            x[0, view].permute(1, 2, 0).numpy()
            for x in (seen.images, pair.views.images)
        )
        assert psnr(image, photo) > 20


def test_the_background_layer_shows_the_background_where_a_foreground_was_taken_away(
    pair, truth
):
    """Without the pixels of the nearest things, their place is filled with what stands around and
    behind them.
    """
    full = build(truth)(pair.views).gaussians
    layer = background_layer(pair.views, truth, 0.9)
    lens = pair.views.intrinsics[:, :1]
    camera = Cameras(truth.c2w[:, :1], lens, pair.views.image_size)
    alone = edit3r.build("rasterizer", "numba").render(layer, camera)
    shown = alone.alphas[0, 0, 0] > 0.5
    assert 0.02 < shown.float().mean() < 0.9
    # soft edges of blocks reach over
    farther = alone.depths[0, 0, 0][shown] > truth.depths[0, 0][shown]
    assert farther.float().mean() > 0.85
    assert full.count > truth.depths.numel()
