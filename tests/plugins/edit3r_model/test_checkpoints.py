"""Weight files: every supported format in, every misfit named, and our own format out and back."""

import argparse
import json
import math
import pickle

import pytest
import torch
import yaml
from edit3r_model.checkpoints import LoadedWeights, convert, is_hub_id, load_weights
from edit3r_model.full_network import empty_network
from edit3r_model.official_checkpoints import (
    infer_config,
    is_unused,
    official_names,
    parameter_names,
)
from noposplat_reference import FULL, Sizes, official_shapes, random_state
from safetensors.torch import save_file

import edit3r
from edit3r.cli.main import main
from edit3r.errors import InputError, MissingDependencyError, SettingsError

HEADS = {"heads": 2, "decoder_heads": 3}
DEPTHS = {"depth": 1, "decoder_depth": 4}


def build(weights, **settings):
    """The small network on given weights; its head widths are not the published ones, so they are
    said.
    """
    backbone = {**HEADS, **settings.pop("backbone", {})}
    return edit3r.build(
        "reconstructor",
        "noposplat",
        weights=str(weights),
        backbone=backbone,
        **settings,
    )


def lightning(path, state):
    torch.save(
        {"state_dict": {f"encoder.{key}": value for key, value in state.items()}}, path
    )
    return path


def test_the_published_network_has_exactly_the_published_keys():
    shapes = official_shapes(FULL)
    meta = {key: torch.empty(shape, device="meta") for key, shape in shapes.items()}
    config = infer_config(meta, "full")
    network = empty_network(config)
    assert sum(
        p.numel() for p in network.parameters()
    ) == 611_996_332 - _unused_parameters(shapes)
    read = {name for ours in parameter_names(config) for name in official_names(ours)}
    assert all(name in shapes for name in read)
    assert {key for key in shapes if key not in read} == {
        key for key in shapes if is_unused(key)
    }
    assert (network.backbone.heads, network.backbone.decoder_heads) == (16, 12)


def _unused_parameters(shapes):
    """mask_token and the never-used residual units; the doubled projections are not counted
    twice.
    """
    unused = {k: v for k, v in shapes.items() if is_unused(k) and ".layer_rn." not in k}
    assert len(unused) == 1 + 4 * 4
    return sum(math.prod(shape) for shape in unused.values())


def test_sizes_come_from_the_checkpoints_own_shapes(checkpoint):
    loaded = load_weights(checkpoint)
    assert loaded.kind == "noposplat" and loaded.unexpected == ()
    assert loaded.config.backbone.settings["width"] == 64
    assert loaded.config.backbone.settings["decoder_depth"] == 10
    assert loaded.config.head.settings["layer_widths"] == (8, 12, 16, 20)
    assert len(loaded.sha256) == 64 and "non-commercial" in loaded.licence


def test_a_bare_state_dict_and_safetensors_give_the_same_network(
    tmp_path, official_state, checkpoint
):
    torch.save(official_state, tmp_path / "bare.pth")
    unique = {k: v.clone() for k, v in official_state.items()}
    save_file(unique, tmp_path / "official.safetensors")
    expected = load_weights(checkpoint)
    for name in ("bare.pth", "official.safetensors"):
        loaded = load_weights(tmp_path / name)
        assert set(loaded.state) == set(expected.state)
        assert all(
            torch.equal(loaded.state[key], expected.state[key])
            for key in expected.state
        )


def test_either_name_of_a_doubled_tensor_is_enough(tmp_path, official_state):
    for gone in (".layer1_rn.", ".layer_rn.0."):
        state = {key: value for key, value in official_state.items() if gone not in key}
        assert build(lightning(tmp_path / "one.ckpt", state)).network is not None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda s: s.pop("backbone.enc_blocks.1.mlp.fc2.bias"),
            "1 missing (backbone.encoder.1.mlp.fc2.bias)",
        ),
        (
            lambda s: s.update({"backbone.enc_blocks.0.ls1.gamma": torch.ones(64)}),
            "1 unexpected",
        ),
        (
            lambda s: s.update({"backbone.dec_norm.weight": torch.ones(7)}),
            "backbone.decoder_norm.weight is [7], expected [48]",
        ),
        (
            lambda s: s.update(
                {
                    "downstream_head2.dpt.head.4.bias": torch.tensor(
                        [0.0, float("nan"), 1.0]
                    )
                }
            ),
            "head.centres.1.out.bias holds 1 values that are not finite",
        ),
        (
            lambda s: s.pop("backbone.patch_embed.proj.weight"),
            "'backbone.patch_embed.proj.weight' is missing",
        ),
    ],
    ids=["missing", "unexpected", "shape", "nan", "sizes unreadable"],
)
def test_weights_that_do_not_fit_are_an_error_that_names_the_key(
    tmp_path, official_state, change, words
):
    state = dict(official_state)
    change(state)
    with pytest.raises(InputError) as error:
        build(lightning(tmp_path / "bad.ckpt", state))
    assert words in str(error.value)


def test_a_mast3r_file_initialises_all_but_what_it_lacks(tmp_path, official_state):
    mast3r = {}
    for key, value in official_state.items():
        if key.startswith("gaussian") or "intrinsic" in key:
            continue
        if ".dpt.head.4." in key:
            value = torch.cat((value, value[:1]))  # the confidence channel
        mast3r[key.removeprefix("backbone.")] = value
    mast3r["downstream_head1.head_local_features.fc1.weight"] = torch.ones(3, 3)
    torch.save(
        {"args": argparse.Namespace(model="x"), "model": mast3r},
        tmp_path / "mast3r.pth",
    )
    network = build(tmp_path / "mast3r.pth").network
    points = network.head.centres[1].out.weight
    assert torch.equal(points, official_state["downstream_head2.dpt.head.4.weight"])
    again = build(tmp_path / "mast3r.pth").network
    assert torch.equal(
        network.head.attributes[0].conv.weight, again.head.attributes[0].conv.weight
    )  # seeded
    other = build(tmp_path / "mast3r.pth", seed=1).network
    assert not torch.equal(
        network.head.attributes[0].conv.weight, other.head.attributes[0].conv.weight
    )


def test_a_mast3r_file_warns_that_part_of_the_network_is_random(
    tmp_path, official_state
):
    from edit3r.reporting import Report, collecting

    state = {k: v for k, v in official_state.items() if not k.startswith("gaussian")}
    state = {
        k.removeprefix("backbone."): torch.cat((v, v[:1])) if ".head.4." in k else v
        for k, v in state.items()
    }
    torch.save({"model": state}, tmp_path / "m.pth")
    with collecting(Report()) as report:
        build(tmp_path / "m.pth")
    assert any("random" in text for text in report.warnings)
    assert report.notes["reconstructor.weights"]["licence"].startswith("CC BY-NC-SA")


class Evil:
    def __reduce__(self):
        return (print, ("code ran",))


def test_a_file_with_code_in_it_is_refused_and_not_run(tmp_path, capsys):
    torch.save({"state_dict": {}, "x": Evil()}, tmp_path / "evil.ckpt")
    with pytest.raises(InputError, match="refused"):
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
    torch.save(
        {"state_dict": {0: torch.ones(1), "unet.conv.weight": torch.ones(1)}},
        tmp_path / "unet.ckpt",
    )
    with pytest.raises(
        InputError, match=r"neither a NoPoSplat checkpoint .* unet\.conv\.weight"
    ):
        load_weights(tmp_path / "unet.ckpt")


def test_heads_that_shapes_do_not_show_must_be_said(tmp_path, checkpoint):
    with pytest.raises(
        SettingsError, match="48 channels do not divide into heads of 64"
    ):
        edit3r.build("reconstructor", "noposplat", weights=str(checkpoint))


def test_sizes_the_user_insists_on_are_checked_against_the_file(checkpoint):
    with pytest.raises(InputError, match="wrong shape"):
        build(checkpoint, backbone={"width": 128})


def test_conversion_keeps_every_value(tmp_path, checkpoint):
    convert(str(checkpoint), tmp_path / "ours", resolution=64, heads=HEADS)
    loaded = load_weights(tmp_path / "ours")
    original = load_weights(checkpoint)
    assert loaded.config.resolution == 64 and loaded.kind == "edit3r"
    assert all(
        torch.equal(loaded.state[key], original.state[key]) for key in original.state
    )
    about = json.loads((tmp_path / "ours" / "config.json").read_text())
    assert about["provenance"]["sha256"] == original.sha256


def test_converted_weights_need_no_further_settings(tmp_path, checkpoint):
    convert(str(checkpoint), tmp_path / "ours", heads=HEADS)
    again = edit3r.build("reconstructor", "noposplat", weights=str(tmp_path / "ours"))
    assert again.network.backbone.heads == 2


def test_the_convert_command_writes_half_size_bf16(tmp_path, checkpoint, capsys):
    code = main(
        [
            "convert",
            str(checkpoint),
            str(tmp_path / "b"),
            "--dtype",
            "bfloat16",
            "--heads=2",
            "--decoder-heads=3",
        ]
    )
    assert code == 0 and "parameters in bfloat16" in capsys.readouterr().out
    stored = load_weights(tmp_path / "b").state
    assert {value.dtype for value in stored.values()} == {torch.bfloat16}


def test_convert_refuses_to_overwrite_its_own_source(tmp_path, checkpoint):
    convert(str(checkpoint), tmp_path / "a", heads=HEADS)
    with pytest.raises(InputError, match="the same"):
        convert(str(tmp_path / "a"), tmp_path / "a")


def test_hub_ids_are_told_from_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (
        is_hub_id("owner/name@0123abc")
        and is_hub_id("owner/name@main:re10k.ckpt")
        and is_hub_id("owner/name")
    )
    assert (
        not is_hub_id("weights/re10k.ckpt")
        and not is_hub_id("/abs/path")
        and not is_hub_id("model.safetensors")
    )
    (tmp_path / "weights" / "ours").mkdir(parents=True)
    assert not is_hub_id("weights/ours")


def test_a_hub_id_without_revision_is_refused():
    with pytest.raises(InputError, match="pinned revision"):
        load_weights("owner/name")


def test_a_hub_id_without_the_library_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingDependencyError, match="pip install huggingface_hub"):
        load_weights("owner/name@main")


def test_loaded_weights_tell_a_manifest_where_they_come_from(checkpoint):
    facts = load_weights(checkpoint).facts()
    assert set(facts) == {"source", "kind", "sha256", "licence"} and isinstance(
        load_weights(checkpoint), LoadedWeights
    )


def test_given_heads_are_checked_against_the_files_width(tmp_path, checkpoint):
    with pytest.raises(SettingsError, match="64 channels in 3 heads"):
        build(checkpoint, backbone={"heads": 3})
    sizes = Sizes(96, 1, 3, 48, 4, 3, 16, 12, (8, 12, 16, 20))
    wide = lightning(tmp_path / "wide.ckpt", random_state(sizes, seed=0))
    assert (
        build(wide, backbone={"heads": 3}).network.backbone.heads == 3
    )  # does not divide the default's 1024


def test_given_heads_without_a_file_are_checked_against_the_networks_own_width():
    sizes = {"heads": 3, "decoder_width": 32, "decoder_heads": 2, **DEPTHS}
    head = {"feature_width": 8, "point_width": 8, "layer_widths": (8, 8, 8, 8)}
    with pytest.raises(SettingsError, match="1024 channels in 3 heads"):
        edit3r.build(
            "reconstructor", "noposplat", weights="random", backbone=sizes, head=head
        )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder `best` that `edit3r train` leaves of a tiny network, whose sizes no default and no
    shape tells.
    """
    out = tmp_path_factory.mktemp("training")
    config = {
        "trainer": {
            "name": "recolor",
            "steps": 1,
            "batch": 1,
            "render_every": 1,
            "validate_every": 1,
        },
        "reconstructor": {
            "name": "noposplat",
            "weights": "random",
            "resolution": 32,
            "backbone": {
                "width": 32,
                "heads": 2,
                "decoder_width": 32,
                "decoder_heads": 8,
                **DEPTHS,
            },
            "head": {
                "feature_width": 8,
                "point_width": 8,
                "layer_widths": [8, 8, 8, 8],
            },
        },
        "rasterizer": "torch",
        "train_data": {
            "name": "procedural",
            "image_size": 32,
            "scenes": 1,
            "targets": 1,
            "textures": 8,
        },
        "losses": {"mse": {"weight": 1.0}},
        "out": str(out),
    }
    (out / "tiny.yaml").write_text(yaml.safe_dump(config))
    assert main(["train", str(out / "tiny.yaml")]) == 0
    return out / "best"


def test_a_trained_network_needs_no_further_settings(trained):
    network = edit3r.build("reconstructor", "noposplat", weights=str(trained)).network
    assert network.backbone.settings.width == 32 and network.backbone.decoder_heads == 8
    assert network.config.resolution == 32
    stored = load_weights(trained).state
    assert all(
        torch.equal(value, stored[name]) for name, value in network.named_parameters()
    )


def test_a_trained_network_of_the_full_form_runs_under_the_name_of_the_paper_s_model(
    trained,
):
    network = edit3r.build("reconstructor", "edit3r", weights=str(trained)).network
    stored = load_weights(trained).state
    assert all(
        torch.equal(value, stored[name]) for name, value in network.named_parameters()
    )


def test_a_trained_network_is_converted(trained, tmp_path, capsys):
    assert main(["convert", str(trained), str(tmp_path / "ours")]) == 0
    assert (
        json.loads((tmp_path / "ours" / "config.json").read_text())["backbone"][
            "settings"
        ]["decoder_heads"]
        == 8
    )
    loaded, original = load_weights(tmp_path / "ours"), load_weights(trained)
    assert loaded.config == original.config and set(loaded.state) == set(original.state)
