import hashlib
import json
import math

import pytest
import skimage.data
import torch
import torch.nn.functional as F
from edit3r_model.backbone import AsymmetricViT
from edit3r_model.conflict_figure import save_conflict_figure
from edit3r_model.small_backbone import MatchedUNet
from edit3r_model.small_head import Decisions, EditFusionHead, assemble
from edit3r_model.small_reconstructor import SHIPPED, network_grid
from edit3r_recolor.steps import paint
from PIL import Image
from safetensors.torch import save_file

from edit3r.cli.main import main
from edit3r.config import parse_assignments
from edit3r.contract.interfaces import MatchedGeometry, Matcher
from edit3r.contract.types import EditRequest, Views
from edit3r.errors import InputError, SettingsError
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.io.run_folder import WeightsRecord
from edit3r.io.weight_files import WEIGHTS, save_weights
from edit3r.pipeline.earlier import EarlierRun
from edit3r.plugins.load import load_plugins
from edit3r.plugins.registry import Registry, build
from edit3r.reporting import Report, collecting
from edit3r_testing import photograph

SIZE = (64, 80)
SCENE = photograph(3, SIZE)


class _TrueGeometry(Matcher):
    """Knows the answer for SCENE's first `views` views."""

    def match(self, views: Views) -> MatchedGeometry:
        count = views.count
        depths = SCENE.depths[:, :count]
        seen = torch.ones(1, count, dtype=torch.bool)
        return MatchedGeometry(
            SCENE.cameras.c2w[:, :count], depths, torch.ones_like(depths), seen
        )


def _reconstructor(**settings):
    return build(
        "reconstructor",
        "edit3r",
        parts={"matcher": _TrueGeometry()},
        **{"network_size": 64, **settings},
    )


def _views(count: int = 2) -> Views:
    return SCENE.views.select(range(count))


def _recoloured(views: Views, which: tuple[int, ...]) -> Views:
    """A strong change of colour on the second ball, in the given views only."""
    images = views.images.clone()
    masks = SCENE.objects[1, :, : views.count, None]
    changed = images[:, :, [2, 0, 1]] * 0.6 + 0.3
    for view in which:
        mask = masks[:, view]
        images[:, view] = mask * changed[:, view] + (1 - mask) * images[:, view]
    return Views(images, views.intrinsics)


def _colours(reconstruction, count: int = 2) -> torch.Tensor:
    """`[view, 3, height, width]` of the pixel-aligned Gaussians (the apron comes after them)."""
    pixels = count * SIZE[0] * SIZE[1]
    colours = dc_to_colour(reconstruction.gaussians.harmonics[0, :pixels, 0])
    return colours.reshape(count, *SIZE, 3).permute(0, 3, 1, 2)


def _inside(view: int = 1) -> torch.Tensor:
    return SCENE.objects[1, 0, view] > 0.9


def test_it_says_what_fusing_added_to_the_views_colours():
    edited = _recoloured(_views(), (0,))
    result = _reconstructor()(edited, _views())
    assert torch.allclose(
        edited.images[0] + result.fusion[0], _colours(result), atol=1e-4
    )
    assert not result.fusion[:, 0].any() and result.fusion[:, 1].abs().max() > 0.1


def test_without_an_edit_colours_are_the_photos_own():
    views = _views()
    assert torch.allclose(
        _colours(_reconstructor()(views, views)), views.images[0], atol=1e-6
    )


def test_the_reference_keeps_its_edit_exactly():
    edited = _recoloured(_views(), (0,))
    assert torch.allclose(
        _colours(_reconstructor()(edited, _views()))[0], edited.images[0, 0], atol=1e-6
    )


def test_an_edit_of_the_reference_alone_is_carried_to_the_other_views():
    views, truth = _views(3), _recoloured(_views(3), (0, 1, 2))
    colours = _colours(_reconstructor()(_recoloured(views, (0,)), views), 3)
    for view in (1, 2):
        shown, true = (
            colours[view] - views.images[0, view],
            truth.images[0, view] - views.images[0, view],
        )
        mask = _inside(view)
        uptake = (shown * true)[:, mask].sum() / true[:, mask].square().sum()
        assert uptake > 0.6
        assert shown.abs().mean(0)[SCENE.objects[1, 0, view] == 0].mean() < 0.03


def test_views_that_agree_stay_as_they_are():
    edited = _recoloured(_views(), (0, 1))
    gap = (_colours(_reconstructor()(edited, _views())) - edited.images[0]).abs()
    assert gap.mean() < 0.02


LUMA = torch.tensor([0.299, 0.587, 0.114])
SEPIA = torch.tensor(
    [[0.393, 0.769, 0.189], [0.349, 0.686, 0.168], [0.272, 0.534, 0.131]]
)
COLOUR_MAPS = {
    "greyscale": lambda images: torch.einsum("c,bvchw->bvhw", LUMA, images)[
        :, :, None
    ].expand_as(images),
    "sepia": lambda images: torch.einsum("dc,bvchw->bvdhw", SEPIA, images),
    "brighter": lambda images: 1.5 * images + 0.05,
    "gamma": lambda images: images.clamp(min=0) ** 0.6,
}


class _WrongGeometry(_TrueGeometry):
    """Takes the scene for a wall, so that what matches is mostly wrong."""

    def match(self, views: Views) -> MatchedGeometry:
        geometry = super().match(views)
        flat = torch.full_like(geometry.depths, geometry.depths.median())
        return MatchedGeometry(
            geometry.c2w, flat, geometry.confidence, geometry.registered
        )


def _photos() -> Views:
    """Three views of SCENE with the colours of a photograph, in 8 bits as files have them."""
    texture = (
        torch.from_numpy(skimage.data.astronaut())
        .float()
        .movedim(-1, 0)[None, :, 60:380, 50:450]
        / 255
    )
    photo = F.interpolate(texture, SIZE, mode="area")
    images = 0.5 * SCENE.views.images + 0.5 * torch.stack(
        [photo.roll(3 * view, -1) for view in range(3)], 1
    )
    return Views((images * 255).round() / 255, SCENE.views.intrinsics)


@pytest.mark.parametrize("matcher", [_TrueGeometry, _WrongGeometry])
@pytest.mark.parametrize("name", COLOUR_MAPS)
def test_one_colour_map_in_every_view_gives_the_edited_photos_own_colours_exactly(
    name, matcher
):
    views = _photos()
    edited = Views(
        (COLOUR_MAPS[name](views.images).clamp(0, 1) * 255).round() / 255,
        views.intrinsics,
    )
    result = build(
        "reconstructor", "edit3r", parts={"matcher": matcher()}, network_size=64
    )(edited, views)
    assert result.fusion is None
    colours = _colours(result, 3)
    assert torch.allclose(colours, edited.images[0], atol=1e-6)
    unfused = build(
        "reconstructor",
        "edit3r",
        parts={"matcher": matcher()},
        network_size=64,
        head={"fuse_edits": False},
    )
    pixels = 3 * SIZE[0] * SIZE[1]
    same = unfused(edited, views).gaussians.opacities[:, :pixels]
    assert torch.equal(result.gaussians.opacities[:, :pixels], same)


@pytest.mark.parametrize("grid", [1.0, 0.5])
def test_paint_that_is_alike_in_every_view_is_no_disagreement_on_a_coarser_grid_either(
    grid,
):
    """Grain is mixed on the grid, and the mean of painted pixels is not what paint makes of their
    mean.
    """
    grain = (
        0.4 * torch.rand(1, 3, 1, *SIZE, generator=torch.Generator().manual_seed(0))
        - 0.2
    )
    views = Views((_photos().images + grain).clamp(0, 1), SCENE.views.intrinsics)
    painted = paint(
        views.images[0], torch.ones_like(views.images[0, :, 0]), (0.1, 0.1, 0.9)
    )
    edited = Views((painted[None] * 255).round() / 255, views.intrinsics)
    result = _reconstructor()(edited, views, EditRequest("", grid=grid))
    assert result.fusion is None


def test_an_object_recoloured_alike_in_every_view_keeps_each_view_s_own_colours():
    edited = _recoloured(_views(), (0, 1))
    gap = (
        (_colours(_reconstructor()(edited, _views()))[1] - edited.images[0, 1])
        .abs()
        .amax(0)
    )
    assert (
        gap[_inside(1)] < 1e-6
    ).float().mean() > 0.5  # all but where the outlines in the views do not meet


def test_two_colour_maps_are_drawn_to_the_reference_s():
    views = _photos()
    grey, sepia = (
        COLOUR_MAPS[name](views.images).clamp(0, 1) for name in ("greyscale", "sepia")
    )
    images = grey.clone()
    images[:, 1] = sepia[:, 1]
    chroma = [
        value.amax(1) - value.amin(1)
        for value in (
            _colours(
                _reconstructor()(
                    Views(images, views.intrinsics).select(range(2)),
                    views.select(range(2)),
                )
            ),
            images[0, :2],
        )
    ]
    assert chroma[0][1].mean() < 0.7 * chroma[1][1].mean()


def _opacities(edited: Views) -> torch.Tensor:
    """`[view, height, width]` of two views whose network corrects nothing."""
    views, zero, choice = (
        _views(),
        torch.zeros(1, 2, *SIZE),
        torch.zeros(1, 2, 3, *SIZE),
    )
    choice[:, :, 0] = 1
    looks = (
        torch.tensor([1.0, 1, 1, 0, 0, 0]).view(1, 1, 6, 1, 1).expand(1, 2, -1, 1, 1)
    )
    decisions = Decisions(zero, zero, zero, looks, torch.zeros(1, 2, 12, *SIZE), choice)
    made = assemble(
        edited.images,
        views,
        _TrueGeometry().match(views),
        decisions,
        EditFusionHead.Settings(),
        (edited.images, views.images),
    )
    return made.opacities.reshape(2, *SIZE)


def test_where_edits_conflict_the_other_view_s_opacity_falls_and_nowhere_else():
    agreeing, inside = _recoloured(_views(), (0, 1)), _inside(1)
    images = agreeing.images.clone()
    images[:, 1] = torch.where(inside, 1 - images[:, 1], images[:, 1])
    fallen, full = _opacities(Views(images, agreeing.intrinsics)), _opacities(agreeing)
    core = (
        -F.max_pool2d(-inside.float()[None, None], 9, 1, 4)[0, 0] > 0
    )  # the outlines in two views do not quite meet
    assert fallen[1][core].mean() < 0.5 * full[1][core].mean()
    assert torch.equal(fallen[0], full[0])
    away = F.max_pool2d(SCENE.objects[1, 0, 1][None, None], 31, 1, 15)[0, 0] == 0
    assert torch.equal(fallen[1][away], full[1][away])
    assert torch.equal(
        full[1][core], _opacities(_views())[1][core]
    )  # agreeing edits change nothing


def _contradicting() -> Views:
    """The second ball in one colour in view 0 and in the opposite one in view 1."""
    agreeing = _recoloured(_views(), (0, 1))
    images, inside = agreeing.images.clone(), SCENE.objects[1, 0, 1] > 0.5
    opposite = (2 * SCENE.views.images[:, 1] - images[:, 1]).clamp(0, 1)
    images[:, 1] = torch.where(inside, opposite, images[:, 1])
    return Views(images, agreeing.intrinsics)


def test_a_novel_view_of_contradicting_edits_shows_the_reference_s():
    truth, camera = (
        _recoloured(_views(3), (0, 1, 2)).images[0, 2],
        SCENE.cameras.select([2]),
    )
    gaussians = _reconstructor()(_contradicting(), _views()).gaussians
    shown = build("rasterizer", "torch").render(gaussians, camera).images[0, 0]
    assert (shown - truth).abs().mean(0)[_inside(2)].mean() < 0.1


def test_the_figure_shows_every_view_s_own_gaussians_and_where_they_give_way(tmp_path):
    edited = _contradicting()
    scene = _reconstructor(apron=0, backdrop=0)(edited, _views())
    photos = Views(_views().images, _views().intrinsics, ("left", "right"))
    run = EarlierRun(photos, edited, scene, ("x",), (), {}, 2)
    reference, other = save_conflict_figure(
        tmp_path / "figure.png", run, build("rasterizer", "torch")
    )
    assert math.isnan(reference[0]) and other[0] < 0.7 * other[1]
    assert Image.open(tmp_path / "figure.png").size[0] > 5 * 256


def test_the_lining_keeps_the_background_from_showing_through_a_view_s_faint_gaussians():
    settings = {"backdrop": 0, "head": {"opacity_repair": 0, "opacity": 0.6}}
    lined, alone = (
        _reconstructor(lining=n, **settings)(_views(), _views()) for n in (0.9, 0)
    )
    camera = SCENE.cameras.select([1])
    alphas = [
        build("rasterizer", "torch").render(s.gaussians.from_view(1), camera).alphas
        for s in (lined, alone)
    ]
    assert alphas[0].median() > alphas[1].median() + 0.05 and alphas[0].median() > 0.95
    assert torch.equal(_colours(lined), _colours(alone))


def test_what_lies_away_from_an_edit_stays_bit_for_bit():
    views, edited = _views(3), _recoloured(_views(3), (0, 1))
    plain, changed = (
        _reconstructor()(given, views).gaussians for given in (views, edited)
    )
    pixels = 3 * SIZE[0] * SIZE[1]
    same = [
        (getattr(plain, name)[0, :pixels] == getattr(changed, name)[0, :pixels])
        .reshape(3, *SIZE, -1)
        .all(-1)
        for name in ("means", "scales", "opacities", "harmonics")
    ]
    kept = torch.stack(same).all(0)
    reach = 2 * 5 + 1  # of a change, and of what hangs on it
    near = F.max_pool2d(SCENE.objects[1, 0, :, None], 2 * reach + 1, 1, reach)[:, 0] > 0
    assert kept[:2][~near[:2]].all() and near[:2].float().mean() < 0.7
    assert not kept[1][_inside(1)].any()
    assert (
        0.5 < kept[2][~near[2]].float().mean() < 1
    )  # it was not edited, so what only it shows may take the edit


def test_switching_fusion_off_shows_every_view_s_own_edit():
    edited = _recoloured(_views(), (0,))
    colours = _colours(_reconstructor(head={"fuse_edits": False})(edited, _views()))
    assert torch.allclose(colours, edited.images[0], atol=1e-6)


def test_points_lie_at_the_matched_depth_unless_repair_is_asked_for():
    views = _views()
    means = _reconstructor()(views, views).gaussians.means[0]
    count = SIZE[0] * SIZE[1]
    assert torch.allclose(means[:count, 2], SCENE.depths[0, 0].flatten(), rtol=1e-4)


def test_the_unit_of_length_is_the_matcher_s():
    class Larger(_TrueGeometry):
        def match(self, views: Views) -> MatchedGeometry:
            geometry = super().match(views)
            c2w = geometry.c2w.clone()
            c2w[..., :3, 3] *= 10
            return MatchedGeometry(
                c2w, geometry.depths * 10, geometry.confidence, geometry.registered
            )

    views = _views()
    larger = build(
        "reconstructor", "edit3r", parts={"matcher": Larger()}, network_size=64
    )(views, views)
    assert torch.allclose(
        larger.gaussians.means,
        10 * _reconstructor()(views, views).gaussians.means,
        rtol=1e-3,
    )
    assert torch.allclose(
        larger.gaussians.scales,
        10 * _reconstructor()(views, views).gaussians.scales,
        rtol=1e-3,
    )


def test_a_guess_before_what_another_photo_measured_is_next_to_transparent():
    patch = (
        0,
        1,
        slice(SIZE[0] // 2, SIZE[0] // 2 + 8),
        slice(SIZE[1] // 2, SIZE[1] // 2 + 8),
    )

    class Floating(_TrueGeometry):
        def match(self, views: Views) -> MatchedGeometry:
            geometry = super().match(views)
            depths, confidence = geometry.depths.clone(), geometry.confidence.clone()
            depths[patch], confidence[patch] = 0.7 * depths[patch], 0
            return MatchedGeometry(
                geometry.c2w, depths, confidence, geometry.registered
            )

    result = build(
        "reconstructor",
        "edit3r",
        parts={"matcher": Floating()},
        network_size=64,
        apron=0,
        backdrop=0,
        lining=0,
    )
    opacities = (
        result(_views(), _views()).gaussians.from_view(1).opacities[0].view(SIZE)
    )
    assert opacities[patch[2:]].median() < 0.2 < 0.4 < opacities.median()


def test_a_view_that_could_not_be_placed_is_not_shown():
    class Lost(_TrueGeometry):
        def match(self, views: Views) -> MatchedGeometry:
            geometry = super().match(views)
            return MatchedGeometry(
                geometry.c2w,
                geometry.depths,
                geometry.confidence,
                torch.tensor([[True, True, False]]),
            )

    result = build(
        "reconstructor", "edit3r", parts={"matcher": Lost()}, network_size=64
    )(_views(3), _views(3))
    assert (result.gaussians.from_view(2).opacities == 0).all()
    assert (result.gaussians.from_view(1).opacities > 0).any()


def test_untrained_weights_are_announced():
    with collecting(Report()) as report:
        _reconstructor(weights="untrained")
    assert any("untrained" in warning for warning in report.warnings)
    assert "weights.edit3r" not in report.notes


def test_shipped_weights_are_recorded_with_hash_and_licence():
    with collecting(Report()) as report:
        _reconstructor()
    record = WeightsRecord(**report.notes["weights.edit3r"])
    assert record.file == SHIPPED.name and record.licence == "Apache-2.0"
    assert record.sha256 == hashlib.sha256(SHIPPED.read_bytes()).hexdigest()


def test_weights_in_half_precision_are_read_at_the_width_that_the_parts_are_given(
    tmp_path,
):
    narrow = {"backbone": {"width": 16}, "head": {"width": 16}}
    state = _reconstructor(weights="untrained", **narrow).network.state_dict()
    save_file(
        {name: tensor.half().contiguous() for name, tensor in state.items()},
        tmp_path / WEIGHTS,
    )
    loaded = _reconstructor(weights=str(tmp_path), **narrow).network.state_dict()
    for name, tensor in state.items():
        assert torch.allclose(loaded[name], tensor, rtol=1e-3, atol=1e-6)


def test_shipped_weights_are_small_enough():
    assert SHIPPED.stat().st_size < 16e6
    assert {"data", "steps", "licence"} <= set(
        json.loads(SHIPPED.with_suffix(".json").read_text())
    )


@pytest.mark.parametrize("name", ["missing.safetensors", "broken.safetensors"])
def test_weights_that_cannot_be_read_are_an_error_that_names_the_file(tmp_path, name):
    (tmp_path / "broken.safetensors").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=name):
        _reconstructor(weights=str(tmp_path / name))


# ---- the parts ----

VIT = {
    "name": "asymmetric-vit",
    "width": 32,
    "depth": 1,
    "heads": 2,
    "decoder_width": 24,
    "decoder_depth": 4,
}
VIT |= {"decoder_heads": 2}
DPT = {
    "name": "dpt-gaussian",
    "feature_width": 8,
    "point_width": 8,
    "layer_widths": [4, 4, 8, 8],
}


def test_describe_shows_the_parts(capsys):
    assert main(["describe", "reconstructor", "edit3r"]) == 0
    shown = capsys.readouterr().out
    assert all(
        part in shown
        for part in ("backbone = matched-unet", "head = edit-fusion", "matcher = ")
    )


def test_another_backbone_carries_the_edit_with_the_same_head():
    """The vision transformer in the place of the U-Net: untrained features, but colours stay the
    photos' own.
    """
    reconstructor = _reconstructor(backbone=VIT, weights="untrained")
    assert (
        type(reconstructor.backbone) is AsymmetricViT and reconstructor.takes_geometry
    )
    colours = _colours(reconstructor(_views(), _views()))
    assert torch.allclose(colours, _views().images[0], atol=1e-6)
    assert (
        _colours(reconstructor(_recoloured(_views(), (0,)), _views()))[1] - colours[1]
    ).abs().max() > 0.02


HEAD = """
import torch
from edit3r import Component, hookimpl
from edit3r.config import Settings
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.contract.interfaces import GaussianHead
from edit3r.contract.types import Gaussians

EDIT3R_API = 1


class Flat(GaussianHead):
    class Settings(Settings):
        pass

    def __init__(self, settings, backbone):
        super().__init__()
        self.scale = torch.nn.Linear(backbone.feature_widths[-1], 1)

    def forward(self, features, images):
        (batch, views, _, height, width), pixels = images.shape, images.movedim(2, -1).reshape(len(images), -1, 3)
        size = self.scale(features.levels[-1]).mean((1, 2, 3)).sigmoid()[:, None, None].expand_as(pixels)
        means = torch.cat((pixels[..., :2] - 0.5, 2 + pixels[..., 2:]), -1)
        quats = torch.tensor([1.0, 0, 0, 0]).expand(batch, means.shape[1], 4)
        index = torch.arange(views).repeat_interleave(height * width)
        return Gaussians(means, size, quats, size[..., 0], colour_to_dc(pixels)[:, :, None], index)


@hookimpl
def register_heads():
    return Component("flat", "edit3r_flat:Flat", "a stranger's head", parts=("backbone",))
"""


@pytest.fixture(scope="module")
def registry(tmp_path_factory) -> Registry:
    """Everything installed, and the stranger's head."""
    file = tmp_path_factory.mktemp("plugin") / "edit3r_flat.py"
    file.write_text(HEAD)
    return Registry(load_plugins((file,)))


def test_trained_weights_of_a_stranger_s_head_and_our_backbone_load(registry, tmp_path):
    made = registry.build(
        "reconstructor",
        "noposplat",
        backbone=VIT,
        head="flat",
        weights="random",
        seed=1,
    )
    save_weights(tmp_path / WEIGHTS, made.network.state_dict())
    loaded = registry.build(
        "reconstructor", "noposplat", head="flat", weights=str(tmp_path)
    )
    assert all(
        torch.equal(a, b)
        for a, b in zip(made.network.parameters(), loaded.network.parameters())
    )


def test_a_stranger_s_head_takes_the_place_of_ours_by_its_name(registry):
    settings = parse_assignments(["head=flat", "weights=untrained", "network_size=64"])
    made = registry.build(
        "reconstructor", "edit3r", {"matcher": _TrueGeometry()}, **settings
    )
    result = made(_recoloured(_views(), (0,)), _views())
    assert type(made.head).__name__ == "Flat" and type(made.backbone) is MatchedUNet
    assert torch.allclose(
        _colours(result), _recoloured(_views(), (0,)).images[0], atol=0.01
    )  # one for each pixel
    assert torch.equal(result.cameras.c2w, SCENE.cameras.c2w[:, :2])


def test_parts_that_take_no_geometry_are_the_paper_s_form():
    made = _reconstructor(
        backbone=VIT, head=DPT, weights="untrained", full={"resolution": 64}
    )
    assert made.full is not None and not made.takes_geometry
    result = made(_views(), _views())
    assert result.cameras is None and torch.equal(
        result.gaussians.means, made.full(_views()).gaussians.means
    )
    with pytest.raises(SettingsError, match="none ship for these parts"):
        _reconstructor(backbone=VIT, head=DPT)


def test_weights_of_other_parts_are_an_error():
    with pytest.raises(InputError, match="not weights of this network"):
        _reconstructor(backbone=VIT)


@pytest.mark.parametrize("kind, settings", [("backbone", {"width": 8}), ("head", {})])
def test_parts_that_need_geometry_say_so_where_there_is_none(kind, settings):
    if kind == "backbone":
        with pytest.raises(InputError, match="needs matched geometry"):
            build("backbone", "matched-unet", **settings)(
                _views().images, _views().intrinsics
            )
    else:
        plain = {
            "backbone": {"name": "asymmetric-vit", **VIT},
            "head": "edit-fusion",
            "weights": "random",
        }
        with pytest.raises(InputError, match="needs matched geometry"):
            build("reconstructor", "noposplat", **plain)(_views())


@pytest.mark.parametrize("size", [(1, 1), (64, 64), (3000, 4000), (10, 1000)])
def test_the_network_s_grid_is_a_multiple_of_8_and_near_the_longer_side(size):
    height, width = network_grid(size, 96, 2)
    assert (
        height % 8 == width % 8 == 0
        and max(height, width) == 96
        and min(height, width) >= 16
    )
