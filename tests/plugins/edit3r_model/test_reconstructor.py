"""Parts, weights that name them, and what follows the single pass in a run."""

import hashlib
import json
from pathlib import Path

import pytest
import torch
from edit3r_model.asymmetric_vit import AsymmetricViT
from edit3r_model.checkpoints import SHIPPED
from edit3r_model.matched_unet import MatchedUNet

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Editor
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Views
from edit3r.kit.files.configs import parse_assignments
from edit3r.kit.weights.files import WEIGHTS, save_weights
from edit3r.loading.load import load_plugins
from edit3r.loading.registry import Registry, build
from edit3r_testing import photograph

SIZES = {"width": 32, "depth": 1, "heads": 2}
VIT = {"name": "asymmetric-vit", "decoder_width": 24, "decoder_heads": 2, **SIZES}
VIT |= {"decoder_depth": 4}
DPT = {"name": "dpt-gaussian", "feature_width": 8, "point_width": 8}
DPT |= {"layer_widths": [4, 4, 8, 8]}
NARROW = {"backbone": {"width": 16}, "head": {"width": 16}}
VIEWS = photograph(2, (32, 48)).views


@pytest.fixture(scope="module")
def registry() -> Registry:
    """Everything installed, and a stranger's head."""
    return Registry(load_plugins((Path(__file__).with_name("plain_head.py"),)))


def small(**settings):
    """The small network on the geometry that its photos carry."""
    return build("reconstructor", "edit3r", **{"network_size": 64, **settings})


def saved(reconstructor, folder: Path) -> str:
    """The folder that a training would leave."""
    state = reconstructor.network.state_dict()
    save_weights(folder / WEIGHTS, state, reconstructor.weights_metadata())
    return str(folder)


def same_weights(one, other) -> bool:
    pairs = zip(one.network.parameters(), other.network.parameters(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def test_describe_shows_the_parts(capsys):
    assert main(["describe", "reconstructor", "edit3r"]) == 0
    shown = capsys.readouterr().out
    for part in ("backbone = matched-unet", "head = edit-fusion"):
        assert part in shown


def test_untrained_weights_are_announced():
    with collecting(Report()) as report:
        small(weights="untrained")
    assert any("untrained" in warning for warning in report.warnings)
    assert "weights.reconstructor" not in report.notes


def test_shipped_weights_are_small_and_recorded_with_hash_and_licence():
    with collecting(Report()) as report:
        small()
    record = report.notes["weights.reconstructor"]
    assert record["file"] == SHIPPED.name and record["licence"] == "Apache-2.0"
    assert record["sha256"] == hashlib.sha256(SHIPPED.read_bytes()).hexdigest()
    assert SHIPPED.stat().st_size < 16e6
    card = json.loads(SHIPPED.with_suffix(".json").read_text())
    assert {"data", "steps", "licence"} <= set(card)


def test_weights_in_half_precision_are_read_at_the_width_that_they_name(tmp_path):
    made = small(weights="untrained", **NARROW)
    half = {name: x.half() for name, x in made.network.state_dict().items()}
    save_weights(tmp_path / WEIGHTS, half, made.weights_metadata())
    loaded = small(weights=str(tmp_path)).network.state_dict()
    for name, tensor in made.network.state_dict().items():
        assert torch.allclose(loaded[name], tensor, rtol=1e-3, atol=1e-6)


def test_a_file_that_names_no_parts_fills_those_of_the_settings(tmp_path):
    made = small(weights="untrained", **NARROW)
    save_weights(tmp_path / WEIGHTS, made.network.state_dict())
    assert same_weights(made, small(weights=str(tmp_path), **NARROW))
    said = r"these weights do not fit this network: .* wrong shape"
    with pytest.raises(InputError, match=said):
        small(weights=str(tmp_path))


def test_what_the_user_sets_of_a_part_counts_over_what_the_file_says(tmp_path):
    head = {"opacity": 0.7, "footprint": 0.5, "depth_repair": 1.0, **NARROW["head"]}
    made = small(weights="untrained", backbone=NARROW["backbone"], head=head)
    loaded = small(weights=saved(made, tmp_path), head={"opacity": 0.3})
    chosen = loaded.network.head.settings
    assert chosen.opacity == 0.3 and chosen.footprint == 0.5
    assert chosen.depth_repair == 0  # counts in training only


def test_weights_for_another_part_than_the_chosen_one_are_an_error(tmp_path):
    words = r"reconstructor\.backbone: shipped weights are for 'matched-unet', .*'asym"
    with pytest.raises(SettingsError, match=words):
        small(backbone=VIT)


@pytest.mark.parametrize("content", [None, b"nonsense"])
def test_weights_that_cannot_be_read_are_an_error_that_names_the_file(
    tmp_path, content
):
    file = tmp_path / "w.safetensors"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=r"w\.safetensors"):
        small(weights=str(file))


def test_a_damaged_description_is_an_error_that_names_the_file(tmp_path):
    state = small(weights="untrained", **NARROW).network.state_dict()
    for backbone in ("no JSON", "{}", '{"name": 3}'):
        save_weights(tmp_path / WEIGHTS, state, {"backbone": backbone, "head": "{}"})
        with pytest.raises(InputError, match=f"{WEIGHTS}: its metadata do not name"):
            small(weights=str(tmp_path))


def test_another_backbone_carries_the_edit_with_the_same_head():
    """The vision transformer in the place of the U-Net: untrained features, but a network."""
    made = small(backbone=VIT, weights="untrained")
    assert type(made.network.backbone) is AsymmetricViT and not made.fuses_by_itself


def test_a_plain_head_is_the_single_pass_with_any_plain_backbone(registry, tmp_path):
    chosen = {"backbone": VIT, "head": "wall", "resolution": 64, "device": "cpu"}
    made = registry.build("reconstructor", "edit3r", weights="untrained", **chosen)
    result = made(VIEWS, VIEWS)
    assert made.fuses_by_itself and result.cameras is None
    direct = made.network(VIEWS.images, VIEWS.intrinsics)
    assert torch.equal(result.gaussians.means, direct.means)
    for name in ("edit3r", "noposplat"):
        weights = saved(made, tmp_path)
        loaded = registry.build("reconstructor", name, weights=weights)
        assert same_weights(made, loaded) and loaded.form.resolution == 64


def test_parts_that_do_not_go_together_are_an_error(registry):
    head = parse_assignments(["head=wall", "weights=untrained"])
    with pytest.raises(SettingsError, match="needs matched geometry, but the head"):
        registry.build("reconstructor", "edit3r", **head)
    with pytest.raises(SettingsError, match="use the reconstructor edit3r"):
        build("reconstructor", "noposplat", weights="shipped")
    said = r"reconstructor\.precision: applies only to"
    with pytest.raises(SettingsError, match=said):
        small(precision="bfloat16")
    unet = build("backbone", "matched-unet", width=8)
    assert type(unet) is MatchedUNet
    with pytest.raises(InputError, match="matched-unet needs geometry"):
        unet(VIEWS.images, VIEWS.intrinsics)


class RedThenBlue(Editor):
    """Contradicts itself: the reference red, all other views blue."""

    def edit(self, views: Views, request) -> Views:
        colours = torch.zeros(views.count, 3)
        colours[0, 0] = 1
        colours[1:, 2] = 1
        images = colours[None, ..., None, None].expand_as(views.images)
        return Views(images, views.intrinsics)


@pytest.fixture(scope="module")
def run_after_a_single_pass(registry):
    chosen = {"backbone": VIT, "head": "wall", "weights": "untrained"}
    recon = registry.build("reconstructor", "edit3r", **chosen)
    parts = {"editor": RedThenBlue(), "recon": recon}
    return lambda **asked: edit3r.run(VIEWS, "x", **parts, report=Report(), **asked)


def off_the_reference_s_edit(result) -> list[float]:
    """How far view 1's rendering is, of what was reconstructed and of what is left of it."""
    camera, red = result.cameras.select([1]), torch.tensor([1.0, 0, 0])[:, None, None]
    made = result.records.reconstructed.reconstruction.gaussians
    shown = (
        build("rasterizer", "torch").render(scene, camera).images[0, 0, :, 8:-8, 8:-8]
        for scene in (made, result.gaussians)
    )
    return [float((inside - red).abs().mean()) for inside in shown]


def test_a_default_run_keeps_what_the_single_pass_fused(run_after_a_single_pass):
    result = run_after_a_single_pass()
    raw, shown = off_the_reference_s_edit(result)
    assert raw == shown <= 0.01
    assert "kept as they are" in result.report.notes["refine.left_out"]


def test_refining_that_is_asked_for_follows_the_single_pass(run_after_a_single_pass):
    result = run_after_a_single_pass(refine=10)
    names = [stage.name for stage in result.report.stages]
    assert "refine" in names and "simplify" not in names
    raw, shown = off_the_reference_s_edit(result)
    assert shown > raw + 0.01


@pytest.mark.parametrize("size", [(32, 40), (40, 32), (0, 32)])
def test_the_backbone_refuses_sides_that_are_no_multiples_of_its_patch(size):
    sizes = {name: value for name, value in VIT.items() if name != "name"}
    backbone = build("backbone", "asymmetric-vit", **sizes)
    said = f"multiples of 16 pixels, got {size[0]}x{size[1]}"
    with pytest.raises(InputError, match=said):
        backbone(torch.zeros(1, 2, 3, *size), torch.eye(3).expand(1, 2, 3, 3))


def test_a_decoder_that_is_too_shallow_for_four_levels_is_a_sentence():
    small = {"width": 64, "depth": 1, "decoder_width": 64}
    with pytest.raises(SettingsError, match=r"backbone\.decoder_depth: .* 3, got 2"):
        build("backbone", "asymmetric-vit", decoder_depth=2, **small)
    made = build("backbone", "asymmetric-vit", decoder_depth=3, **small)
    assert made.hooks == (0, 1, 2, 3)
