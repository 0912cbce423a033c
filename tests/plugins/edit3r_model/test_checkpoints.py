"""Weight files: every supported format in, every misfit named, and our own format out and back."""

import argparse
import math
import pickle

import pytest
import torch
from edit3r_model import OFFICIAL
from edit3r_model.checkpoints import LoadedWeights, load_weights, with_parts_of
from edit3r_model.network import built
from edit3r_model.official_checkpoints import infer_parts, is_unused, official_names
from noposplat_reference import FULL, Sizes, official_shapes, random_state
from safetensors.torch import save_file

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError, MissingDependencyError, SettingsError
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.settings import PartChoice
from edit3r_testing import photograph

HEADS = {"heads": 2, "decoder_heads": 3}


def build(weights, name="noposplat", **settings):
    """The small network on given weights; its head widths are not the published ones, so they are
    said.
    """
    backbone = {**HEADS, **settings.pop("backbone", {})}
    settings = {"weights": str(weights), "backbone": backbone, **settings}
    return edit3r.build("reconstructor", name, **settings)


def lightning(path, state):
    named = {f"encoder.{key}": value for key, value in state.items()}
    torch.save({"state_dict": named}, path)
    return path


def mast3r(path, state):
    """The same weights as MASt3R has them: with a confidence channel, without colours."""
    kept = {"downstream_head1.head_local_features.fc1.weight": torch.ones(3, 3)}
    for key, value in state.items():
        if not key.startswith("gaussian") and "intrinsic" not in key:
            last = ".dpt.head.4." in key
            value = torch.cat((value, value[:1])) if last else value
            kept[key.removeprefix("backbone.")] = value
    torch.save({"args": argparse.Namespace(model="x"), "model": kept}, path)
    return path


def test_the_published_network_has_exactly_the_published_keys():
    shapes = official_shapes(FULL)
    meta = {key: torch.empty(shape, device="meta") for key, shape in shapes.items()}
    network = built(infer_parts(meta, "full"))
    unused = {key for key in shapes if is_unused(key)}
    # mask_token and the residual units that never run; doubled projections are not counted twice.
    left_out = [key for key in unused if ".layer_rn." not in key]
    gone = sum(math.prod(shapes[key]) for key in left_out)
    count = sum(p.numel() for p in network.parameters())
    assert len(left_out) == 1 + 4 * 4 and count == 611_996_332 - gone
    names = [name for name, _ in network.named_parameters()]
    read = {key for ours in names for key in official_names(ours)}
    assert read == shapes.keys() - unused
    assert (network.backbone.heads, network.backbone.decoder_heads) == (16, 12)


def test_sizes_come_from_the_checkpoints_own_shapes(checkpoint):
    loaded = load_weights(checkpoint)
    backbone, head = (loaded.parts[kind].settings for kind in ("backbone", "head"))
    assert loaded.kind == "noposplat" and "non-commercial" in loaded.licence
    assert backbone["width"] == 64 and backbone["decoder_depth"] == 10
    assert head["layer_widths"] == (8, 12, 16, 20)


@pytest.mark.slow
def test_a_bare_state_dict_and_safetensors_give_the_same_network(
    tmp_path, official_state, checkpoint
):
    torch.save(official_state, tmp_path / "bare.pth")
    unique = {key: value.clone() for key, value in official_state.items()}
    save_file(unique, tmp_path / "official.safetensors")
    expected = build(checkpoint).network.state_dict()
    for name in ("bare.pth", "official.safetensors"):
        for key, value in build(tmp_path / name).network.state_dict().items():
            assert torch.equal(value, expected[key]), key


@pytest.mark.slow
def test_either_name_of_a_doubled_tensor_is_enough(tmp_path, official_state):
    for gone in (".layer1_rn.", ".layer_rn.0."):
        state = {key: value for key, value in official_state.items() if gone not in key}
        assert build(lightning(tmp_path / "one.ckpt", state)).network is not None


NAN = torch.tensor([0.0, float("nan"), 1.0])
MISFITS = {
    "missing": (
        {"backbone.enc_blocks.1.mlp.fc2.bias": None},
        "1 missing (backbone.encoder.1.mlp.fc2.bias)",
    ),
    "missing, another there": (
        {
            "backbone.enc_blocks.1.mlp.fc2.bias": None,
            "backbone.enc_blocks.1.mlp.fc3.bias": torch.ones(64),
        },
        "1 unexpected (backbone.enc_blocks.1.mlp.fc3.bias)",
    ),
    "shape": (
        {"backbone.dec_norm.weight": torch.ones(7)},
        "backbone.decoder_norm.weight is [7], expected [48]",
    ),
    "nan": (
        {"downstream_head2.dpt.head.4.bias": NAN},
        "head.centres.1.out.bias holds 1 values that are not finite",
    ),
    "sizes unreadable": (
        {"backbone.patch_embed.proj.weight": None},
        "'backbone.patch_embed.proj.weight' is missing",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("change", "words"), MISFITS.values(), ids=MISFITS)
def test_weights_that_do_not_fit_are_an_error_that_names_the_key(
    tmp_path, official_state, change, words
):
    state = {k: v for k, v in (official_state | change).items() if v is not None}
    with pytest.raises(InputError) as error:
        build(lightning(tmp_path / "bad.ckpt", state), "edit3r")
    assert words in str(error.value)


@pytest.mark.slow
def test_keys_beyond_the_network_s_are_noted_and_left(tmp_path, official_state):
    """As a checkpoint has them that was saved with a frozen reference and CLIP."""
    more = {"clip.visual.weight": torch.ones(2), "reference.bias": torch.ones(3)}
    file = lightning(tmp_path / "more.ckpt", official_state)
    content = torch.load(file, weights_only=True)
    content["state_dict"] |= more
    torch.save(content, file)
    with collecting(Report()) as report:
        network = build(file).network
    told = report.notes["weights_left_over"]
    assert told.startswith("2 tensors") and all(key in told for key in more)
    bias = network.backbone.encoder[0].mlp.fc1.bias
    assert torch.equal(bias, official_state["backbone.enc_blocks.0.mlp.fc1.bias"])


@pytest.mark.slow
def test_a_mast3r_file_initialises_all_but_what_it_lacks(tmp_path, official_state):
    file = mast3r(tmp_path / "mast3r.pth", official_state)
    with collecting(Report()) as report:
        made = [build(file, seed=seed).network.head for seed in (0, 0, 1)]
    points = official_state["downstream_head2.dpt.head.4.weight"]
    assert torch.equal(made[0].centres[1].out.weight, points)
    first, again, other = (head.attributes[0].conv.weight for head in made)
    assert torch.equal(first, again) and not torch.equal(first, other)
    assert any("random" in text for text in report.warnings)
    licence = report.notes["reconstructor.weights"]["licence"]
    assert licence.startswith("CC BY-NC-SA")


class Evil:
    def __reduce__(self):
        return (print, ("code ran",))


def test_a_file_with_code_in_it_is_refused_and_not_run(tmp_path, capsys):
    torch.save({"state_dict": {}, "x": Evil()}, tmp_path / "evil.ckpt")
    with pytest.raises(InputError, match=r"refused.*nothing in it was run.*save_file"):
        load_weights(tmp_path / "evil.ckpt")
    assert "code ran" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 no zip", b"hello", pickle.dumps([1, 2])]
)
def test_damaged_files_end_in_a_sentence(tmp_path, content):
    for name in ("x.ckpt", "x.safetensors"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            load_weights(tmp_path / name)


def test_a_checkpoint_of_something_else_says_what_was_expected(tmp_path):
    content = {"state_dict": {0: torch.ones(1), "unet.conv.weight": torch.ones(1)}}
    torch.save(content, tmp_path / "unet.ckpt")
    words = r"neither a NoPoSplat checkpoint .* unet\.conv\.weight"
    with pytest.raises(InputError, match=words):
        load_weights(tmp_path / "unet.ckpt")


def test_heads_that_shapes_do_not_show_must_be_said_and_fit_the_file(
    tmp_path, checkpoint
):
    said = "48 channels cannot be split into heads of"
    with pytest.raises(SettingsError, match=said):
        edit3r.build("reconstructor", "noposplat", weights=str(checkpoint))
    with pytest.raises(SettingsError, match="64 channels in 3 heads"):
        build(checkpoint, backbone={"heads": 3})
    sizes = Sizes(96, 1, 3, 48, 4, 3, 16, 12, (8, 12, 16, 20))
    wide = lightning(tmp_path / "wide.ckpt", random_state(sizes, seed=0))
    assert build(wide, backbone={"heads": 3}).network.backbone.heads == 3


def test_heads_without_a_file_are_checked_against_the_network_s_own_width():
    with pytest.raises(SettingsError, match="1024 channels in 3 heads"):
        build("random", backbone={"heads": 3})


def test_sizes_the_user_insists_on_are_checked_against_the_file(checkpoint):
    with pytest.raises(InputError, match="wrong shape"):
        build(checkpoint, backbone={"width": 128})


TINY = """
trainer: {name: recolor, steps: 1, batch: 1, validate_every: 1}
reconstructor:
  name: noposplat
  weights: random
  resolution: 32
  backbone: {width: 32, depth: 1, heads: 2, decoder_width: 32, decoder_depth: 4, decoder_heads: 8}
  head: {feature_width: 8, point_width: 8, layer_widths: [8, 8, 8, 8]}
rasterizer: torch
train_data: {name: procedural, image_size: 32, scenes: 1, targets: 1, textures: 8}
losses: {mse: {weight: 1.0}}
"""


@pytest.mark.slow
def test_what_is_trained_is_used_without_further_settings(tmp_path):
    """No default and no shape tells the sizes of this network."""
    (tmp_path / "tiny.yaml").write_text(TINY)
    assert main(["train", str(tmp_path / "tiny.yaml"), "--out", str(tmp_path)]) == 0
    stored = load_weights(tmp_path / "best").tensors
    with pytest.raises(InputError, match=r"its weights are in .*best"):
        load_weights(tmp_path / "last.pt")
    # "": that of the training
    for name, folder in (("edit3r", "best"), ("noposplat", "best"), ("edit3r", "")):
        weights = str(tmp_path / folder)
        made = edit3r.build("reconstructor", name, weights=weights)
        assert made.form.resolution == 32 and made.network.backbone.decoder_heads == 8
        for key, value in made.network.state_dict().items():
            assert torch.equal(value, stored[key]), key


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """Where `edit3r weights get` would put the authors' file; nothing is there yet."""
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    path = tmp_path / OFFICIAL.name / "edit3r.ckpt"
    path.parent.mkdir()
    return path


@pytest.mark.parametrize("name", ["edit3r", "noposplat"])
def test_without_the_file_licence_and_command_are_told_and_nothing_is_fetched(
    stored, name
):
    words = r"edit3r weights get edit3r-official .*CC BY-NC-SA"
    with pytest.raises(MissingDependencyError, match=words):
        build("official", name)


@pytest.mark.slow
def test_the_official_weights_bring_their_parts_and_their_own_resolution(
    stored, official_state
):
    lightning(stored, official_state)
    views = photograph(2, (32, 48)).views
    with collecting(Report()) as report:
        edited = build("official", "edit3r", precision="float32")
    plain, by_file = build("official"), build(stored)
    resolutions = [made.form.resolution for made in (edited, plain, by_file)]
    assert resolutions == [512, 512, 256] and edited.fuses_by_itself
    assert report.notes["weights.reconstructor"]["licence"] == OFFICIAL.licence
    means = [made(views, views).gaussians.means for made in (edited, plain)]
    assert torch.equal(*means)


@pytest.mark.parametrize("form", [str, lambda name: PartChoice(name=name), dict])
def test_a_part_is_chosen_in_any_form(form, tmp_path):
    stored = {"backbone": PartChoice(name="croco", settings={"depth": 2})}
    loaded = LoadedWeights(tmp_path, "file", "edit3r", {}, stored)
    given = {"name": "croco"} if form is dict else "croco"
    filled = with_parts_of(loaded, {"backbone": form(given)})
    assert filled["backbone"] == {"name": "croco", "depth": 2}
    if form is not dict:
        with pytest.raises(SettingsError, match="weights are for 'croco'"):
            with_parts_of(loaded, {"backbone": form("small")})
