"""The matched form with the weights that ship: what it keeps, what it carries, what gives way."""

from dataclasses import replace
from pathlib import Path

import pytest
import skimage.data
import torch
import torch.nn.functional as F
from edit3r_model.edit_fusion_head import (
    CONFLICT_OPACITY,
    Choices,
    Decisions,
    EditFusionHead,
    assemble,
)
from edit3r_model.matched_form import network_grid
from edit3r_recolor.paint import paint

from edit3r.contract.interfaces import GaussianHead, Geometry, Matcher
from edit3r.contract.types import Views
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.reconstructing import WithMatcher
from edit3r.loading.registry import build
from edit3r_testing import photograph

SIZE = (64, 80)
SCENE = photograph(3, SIZE)


class TrueGeometry(Matcher):
    """Knows the answer for SCENE's first views; `changes` are fields that it gets wrong."""

    def __init__(self, **changes) -> None:
        self.changes = changes

    def match(self, views: Views) -> Geometry:
        count = views.count
        depths = SCENE.depths[:, :count]
        seen = torch.ones(1, count, dtype=torch.bool)
        c2w = SCENE.cameras.c2w[:, :count]
        geometry = Geometry(c2w, depths, torch.ones_like(depths), seen)
        return replace(geometry, **self.changes)


def reconstructor(matcher: Matcher | None = None, **settings) -> WithMatcher:
    settings = {"network_size": 64, **settings}
    built = build("reconstructor", "edit3r", **settings)
    return WithMatcher(built, matcher or TrueGeometry())


@pytest.fixture(scope="module")
def shipped():
    return reconstructor()


class Repeats(GaussianHead):
    """The small head's Gaussians, each so many times; 0: once, and none knows its pixel."""

    uses_geometry = True

    def __init__(self, inner, per_pixel):
        super().__init__()
        self.inner, self.per_pixel = inner, per_pixel

    def forward(self, *given):
        made = self.inner(*given)
        if self.per_pixel == 0:
            return replace(made, view_index=None)
        return made.select(torch.arange(made.count).repeat_interleave(self.per_pixel))


@pytest.mark.parametrize("per_pixel", [0, 3])
def test_surroundings_follow_a_head_of_other_than_one_gaussian_a_pixel(per_pixel):
    plain, other = reconstructor(), reconstructor()
    network = other.reconstructor.network
    network.head = Repeats(network.head, per_pixel)
    expected, made = plain(views_of()), other(views_of())
    assert made.per_pixel == per_pixel
    assert float(made.gaussians.opacities[:, 0]) > 0.3
    pixels = 2 * SIZE[0] * SIZE[1]
    starts = pixels, pixels * max(per_pixel, 1)
    around, found = (
        scene.select(torch.arange(start, scene.count))
        for scene, start in zip((expected.gaussians, made.gaussians), starts)
    )
    for name in ("means", "opacities", "harmonics"):
        assert torch.allclose(getattr(found, name), getattr(around, name), atol=1e-5)


def test_gaussians_of_no_view_stay_where_a_view_could_not_be_placed():
    lost = reconstructor(TrueGeometry(registered=torch.tensor([[True, True, False]])))
    network = lost.reconstructor.network
    pixels = 3 * SIZE[0] * SIZE[1]
    assert float(lost(views_of(3)).gaussians.opacities[:, pixels - 1]) == 0
    network.head = Repeats(network.head, 0)
    assert float(lost(views_of(3)).gaussians.opacities[:, :pixels].min()) > 0


def views_of(count: int = 2) -> Views:
    return SCENE.views.select(range(count))


def recoloured(views: Views, which: tuple[int, ...]) -> Views:
    """A strong change of colour on the second ball, in the given views only."""
    images = views.images.clone()
    changed = images[:, :, [2, 0, 1]] * 0.6 + 0.3
    for view in which:
        mask = SCENE.objects[1, :, view, None]
        images[:, view] = mask * changed[:, view] + (1 - mask) * images[:, view]
    return Views(images, views.intrinsics)


def contradicting() -> Views:
    """The second ball in one colour in view 0 and in the opposite one in view 1."""
    agreeing = recoloured(views_of(), (0, 1))
    images, ball = agreeing.images.clone(), SCENE.objects[1, 0, 1] > 0.5
    opposite = (2 * SCENE.views.images[:, 1] - images[:, 1]).clamp(0, 1)
    images[:, 1] = torch.where(ball, opposite, images[:, 1])
    return Views(images, agreeing.intrinsics)


def colours_of(reconstruction, count: int = 2) -> torch.Tensor:
    """`[view, 3, height, width]` of the pixel-aligned Gaussians (the rim comes after them)."""
    pixels = count * SIZE[0] * SIZE[1]
    colours = dc_to_colour(reconstruction.gaussians.harmonics[0, :pixels, 0])
    return colours.reshape(count, *SIZE, 3).permute(0, 3, 1, 2)


def inside(view: int = 1) -> torch.Tensor:
    return SCENE.objects[1, 0, view] > 0.9


def test_without_an_edit_colours_are_the_photos_own(shipped):
    colours = colours_of(shipped(views_of(), views_of()))
    assert torch.allclose(colours, views_of().images[0], atol=1e-6)


def test_the_reference_keeps_its_edit_and_what_fusing_added_elsewhere_is_said(shipped):
    edited = recoloured(views_of(), (0,))
    result = shipped(edited, views_of())
    colours = colours_of(result)
    assert torch.allclose(colours[0], edited.images[0, 0], atol=1e-6)
    assert torch.allclose(edited.images[0] + result.fusion[0], colours, atol=1e-4)
    assert not result.fusion[:, 0].any() and result.fusion[:, 1].abs().max() > 0.1


def test_an_edit_of_the_reference_alone_is_carried_to_the_other_views(shipped):
    views, truth = views_of(3), recoloured(views_of(3), (0, 1, 2))
    colours = colours_of(shipped(recoloured(views, (0,)), views), 3)
    for view in (1, 2):
        shown = colours[view] - views.images[0, view]
        true = truth.images[0, view] - views.images[0, view]
        mask = inside(view)
        uptake = (shown * true)[:, mask].sum() / true[:, mask].square().sum()
        away = SCENE.objects[1, 0, view] == 0
        assert uptake > 0.6 and shown.abs().mean(0)[away].mean() < 0.03


LUMA = torch.tensor([0.299, 0.587, 0.114])
SEPIA = torch.tensor([[393, 769, 189], [349, 686, 168], [272, 534, 131]]) / 1000


def greyscale(images):
    return torch.einsum("c,bvchw->bvhw", LUMA, images)[:, :, None].expand_as(images)


def sepia(images):
    return torch.einsum("dc,bvchw->bvdhw", SEPIA, images).clamp(0, 1)


def brighter(images):
    return (1.5 * images + 0.05).clamp(0, 1)


def gamma(images):
    return images.clamp(min=0) ** 0.6


def eight_bits(images):
    return (images * 255).round() / 255


def photos() -> Views:
    """Three views of SCENE with the colours of a photograph, in 8 bits as files have them."""
    astronaut = torch.from_numpy(skimage.data.astronaut()).float().movedim(-1, 0)
    photo = F.interpolate(astronaut[None, :, 60:380, 50:450] / 255, SIZE, mode="area")
    texture = torch.stack([photo.roll(3 * view, -1) for view in range(3)], 1)
    images = eight_bits(0.5 * SCENE.views.images + 0.5 * texture)
    return Views(images, SCENE.views.intrinsics)


WALL = {"depths": SCENE.depths.median().expand_as(SCENE.depths)}


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [{}, WALL], ids=["true depth", "a wall's"])
@pytest.mark.parametrize("filtered", [greyscale, sepia, brighter, gamma])
def test_one_colour_map_in_every_view_leaves_each_its_own_colours_and_opacity(
    filtered, wrong
):
    views = photos()
    edited = Views(eight_bits(filtered(views.images)), views.intrinsics)
    result = reconstructor(TrueGeometry(**wrong))(edited, views)
    assert result.fusion is None
    assert torch.allclose(colours_of(result, 3), edited.images[0], atol=1e-6)
    plain = reconstructor(TrueGeometry(**wrong), head={"fuse_edits": False})
    opacities = plain(edited, views).gaussians.opacities
    assert torch.equal(result.gaussians.opacities, opacities)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_paint_alike_in_every_view_is_no_disagreement_on_a_coarser_grid_either(
    shipped, share
):
    """Grain is mixed on the grid, and the mean of painted pixels is not what paint makes of their
    mean.
    """
    generator = torch.Generator().manual_seed(0)
    grain = 0.4 * torch.rand(1, 3, 1, *SIZE, generator=generator) - 0.2
    views = Views((photos().images + grain).clamp(0, 1), SCENE.views.intrinsics)
    everywhere = torch.ones_like(views.images[0, :, 0])
    painted = paint(views.images[0], everywhere, (0.1, 0.1, 0.9))
    edited = Views(eight_bits(painted[None]), views.intrinsics)
    grid = (round(share * SIZE[0]), round(share * SIZE[1]))
    assert shipped(edited, views, grid).fusion is None


def test_an_object_recoloured_alike_in_every_view_keeps_each_view_s_own_colours(
    shipped,
):
    edited = recoloured(views_of(), (0, 1))
    gap = (colours_of(shipped(edited, views_of())) - edited.images[0]).abs()
    assert gap.mean() < 0.02
    # All but where the outlines in the views do not meet.
    assert (gap[1].amax(0)[inside(1)] < 1e-6).float().mean() > 0.5


def test_two_colour_maps_are_drawn_to_the_reference_s(shipped):
    views = photos().select(range(2))
    grey, brown = greyscale(views.images), sepia(views.images)
    given = Views(torch.stack((grey[:, 0], brown[:, 1]), 1), views.intrinsics)
    fused = colours_of(shipped(given, views))[1]
    chroma = [(x.amax(0) - x.amin(0)).mean() for x in (fused, given.images[0, 1])]
    assert chroma[0] < 0.7 * chroma[1]


def opacities_of(edited: Views) -> torch.Tensor:
    """`[view, height, width]` of two views whose network corrects nothing."""
    views, none = views_of(), torch.zeros(1, 2, 12, *SIZE)
    same = torch.tensor([1.0, 1, 1, 0, 0, 0]).view(6, 1, 1).expand(1, 2, -1, 1, 1)
    own = torch.tensor([1.0, 0, 0]).view(3, 1, 1).expand(1, 2, 3, *SIZE)
    decided = Decisions(none[:, :, :3], Choices(same, none, own))
    given = edited.images, views, TrueGeometry().match(views), decided
    settings = EditFusionHead.Settings()
    made = assemble(*given, settings, (edited.images, views.images))
    return made.opacities.reshape(2, *SIZE)


def test_where_edits_conflict_the_other_view_s_opacity_falls_and_nowhere_else():
    agreeing, ball = recoloured(views_of(), (0, 1)), inside(1)
    images = agreeing.images.clone()
    images[:, 1] = torch.where(ball, 1 - images[:, 1], images[:, 1])
    full = opacities_of(agreeing)
    fallen = opacities_of(replace(agreeing, images=images))
    # The outlines in two views do not quite meet.
    core = -F.max_pool2d(-ball.float()[None, None], 9, 1, 4)[0, 0] > 0
    away = F.max_pool2d(SCENE.objects[1, 0, 1][None, None], 31, 1, 15)[0, 0] == 0
    assert fallen[1][core].mean() < 0.5 * full[1][core].mean()
    assert torch.equal(fallen[0], full[0])
    assert torch.equal(fallen[1][away], full[1][away])
    unedited = opacities_of(views_of())
    assert torch.equal(full[1][core], unedited[1][core])


def test_what_is_set_by_hand_stands_in_the_model_card():
    card = Path(__file__).parents[3] / "docs" / "model-card.md"
    assert f"`head.conflict_opacity` (`{CONFLICT_OPACITY}`)" in card.read_text()
    assert EditFusionHead.Settings().conflict_opacity == CONFLICT_OPACITY


def test_a_novel_view_of_contradicting_edits_shows_the_reference_s(shipped):
    truth = recoloured(views_of(3), (0, 1, 2)).images[0, 2]
    gaussians = shipped(contradicting(), views_of()).gaussians
    camera = SCENE.cameras.select([2])
    shown = build("rasterizer", "torch").render(gaussians, camera).images[0, 0]
    assert (shown - truth).abs().mean(0)[inside(2)].mean() < 0.1


def test_what_lies_away_from_an_edit_stays_bit_for_bit(shipped):
    views, edited = views_of(3), recoloured(views_of(3), (0, 1))
    plain, changed = (shipped(given, views).gaussians for given in (views, edited))
    pixels = 3 * SIZE[0] * SIZE[1]
    kept = torch.ones(3, *SIZE, dtype=torch.bool)
    for name in ("means", "scales", "opacities", "harmonics"):
        before, after = (getattr(g, name)[0, :pixels] for g in (plain, changed))
        kept &= (before == after).reshape(3, *SIZE, -1).all(-1)
    reach = 2 * 5 + 1  # of a change, and of what hangs on it
    near = F.max_pool2d(SCENE.objects[1, 0, :, None], 2 * reach + 1, 1, reach)[:, 0] > 0
    assert kept[:2][~near[:2]].all() and near[:2].float().mean() < 0.7
    assert not kept[1][inside(1)].any()
    # View 2 was not edited, so what only it shows may take the edit.
    assert 0.5 < kept[2][~near[2]].float().mean() < 1


def test_switching_fusion_off_shows_every_view_s_own_edit():
    edited = recoloured(views_of(), (0,))
    plain = reconstructor(head={"fuse_edits": False})
    colours = colours_of(plain(edited, views_of()))
    assert torch.allclose(colours, edited.images[0], atol=1e-6)


def test_centres_move_the_correction_of_depth_and_colours_do_not():
    """Colours look at the corrected depth without a say in it."""
    edited, source = contradicting(), views_of()
    strength = {}
    for repair, name in ((1.0, "means"), (0.0, "harmonics")):
        recon = reconstructor(head={"depth_repair": repair})
        recon.reconstructor.network.train()
        gaussians = recon(edited, source).gaussians
        getattr(gaussians, name).square().sum().backward()
        # The first third of the channels is depth's.
        corrections = recon.reconstructor.network.head.corrections.weight.grad
        strength[name] = float(corrections[: len(corrections) // 3].abs().max())
    assert strength["means"] > 0 and strength["harmonics"] == 0


def test_points_lie_at_the_matched_depth_in_the_matcher_s_unit(shipped):
    views, pixels = views_of(), SIZE[0] * SIZE[1]
    made = shipped(views, views)
    own = made.gaussians
    assert torch.allclose(made.cameras.c2w, SCENE.cameras.c2w[:, :2], atol=1e-6)
    depths = SCENE.depths[0, 0].flatten()
    assert torch.allclose(own.means[0, :pixels, 2], depths, rtol=1e-4)
    c2w = SCENE.cameras.c2w[:, :2].clone()
    c2w[..., :3, 3] *= 10
    matcher = TrueGeometry(c2w=c2w, depths=10 * SCENE.depths[:, :2])
    made = reconstructor(matcher)(views, views)
    larger = made.gaussians
    assert torch.allclose(made.cameras.c2w, c2w, atol=1e-5)
    assert torch.allclose(larger.means, 10 * own.means, rtol=1e-3)
    assert torch.allclose(larger.scales, 10 * own.scales, rtol=1e-3)


def test_a_guess_before_what_another_photo_measured_is_next_to_transparent():
    patch = (slice(32, 40), slice(40, 48))
    depths = SCENE.depths[:, :2].clone()
    confidence = torch.ones_like(depths)
    depths[(0, 1, *patch)] *= 0.7
    confidence[(0, 1, *patch)] = 0
    matcher = TrueGeometry(depths=depths, confidence=confidence)
    made = reconstructor(matcher, rim=0, background_layer=0)
    view = made(views_of(), views_of()).gaussians.from_view(1)
    opacities = view.opacities[0].view(SIZE)
    assert opacities[patch].median() < 0.2 < 0.4 < opacities.median()


def test_a_view_that_could_not_be_placed_is_not_shown():
    matcher = TrueGeometry(registered=torch.tensor([[True, True, False]]))
    gaussians = reconstructor(matcher)(views_of(3), views_of(3)).gaussians
    assert (gaussians.from_view(2).opacities == 0).all()
    assert (gaussians.from_view(1).opacities > 0).any()


@pytest.mark.parametrize("size", [(1, 1), (64, 64), (3000, 4000), (10, 1000)])
def test_the_network_s_grid_is_a_multiple_of_8_and_near_the_longer_side(size):
    grid = network_grid(size, 96, 2)
    assert max(grid) == 96 and min(grid) >= 16
    assert all(side % 8 == 0 for side in grid)
