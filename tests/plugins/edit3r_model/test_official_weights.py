"""The authors' own weights under their name, here as a tiny checkpoint of the same format."""

import hashlib

import pytest
import torch
from edit3r_model import OFFICIAL
from edit3r_model.checkpoints import load_weights

from edit3r.errors import InputError, MissingDependencyError, SettingsError
from edit3r.plugins.registry import build
from edit3r.reporting import Report, collecting
from edit3r_testing import photograph

HEADS = {"backbone": {"heads": 2, "decoder_heads": 3}}


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """Where `edit3r weights get` would put the file; nothing is there yet."""
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    path = tmp_path / OFFICIAL.name / "edit3r.ckpt"
    path.parent.mkdir()
    return path


def write(path, state):
    torch.save(
        {"state_dict": {f"encoder.{key}": value for key, value in state.items()}}, path
    )


@pytest.mark.parametrize("name", ["edit3r", "noposplat"])
def test_without_the_file_licence_and_command_are_told_and_nothing_is_fetched(
    stored, name
):
    with pytest.raises(
        MissingDependencyError,
        match=r"edit3r weights get edit3r-official .*CC BY-NC-SA",
    ):
        build("reconstructor", name, weights="official")


def test_the_official_weights_are_the_full_form_at_their_own_resolution(
    stored, official_state
):
    write(stored, official_state)
    with collecting(Report()) as report:
        edited = build("reconstructor", "edit3r", weights="official", full=HEADS)
    plain = build("reconstructor", "noposplat", weights="official", **HEADS)
    by_file = build("reconstructor", "noposplat", weights=str(stored), **HEADS)
    assert (edited.full.resolution, plain.resolution, by_file.resolution) == (
        512,
        512,
        256,
    )
    record = report.notes["weights.reconstructor"]
    assert record["sha256"] == hashlib.sha256(stored.read_bytes()).hexdigest()
    assert record["licence"] == OFFICIAL.licence
    views = photograph(2, (32, 48)).views
    with torch.no_grad():
        results = [
            reconstructor(views, views).gaussians.means
            for reconstructor in (edited, plain)
        ]
    assert torch.equal(*results) and not edited.takes_geometry


@pytest.mark.parametrize("change", ["missing", "unexpected"])
def test_every_key_that_does_not_fit_is_an_error(stored, official_state, change):
    state, key = dict(official_state), "backbone.enc_blocks.1.attn.proj.weight"
    if change == "missing":
        del state[key]
    else:
        state["backbone.another.weight"] = torch.zeros(1)
    write(stored, state)
    with pytest.raises(InputError, match=f"1 {change}"):
        build("reconstructor", "edit3r", weights="official", full=HEADS)


def test_a_file_that_holds_more_than_tensors_is_refused_with_the_way_out(stored):
    torch.save({"state_dict": {}, "x": pytest.raises}, stored)
    with pytest.raises(
        InputError,
        match=r"refused.*nothing in it was run.*safetensors\.torch\.save_file",
    ):
        load_weights("official")


def test_settings_of_the_full_form_without_its_weights_are_an_error():
    with pytest.raises(SettingsError, match=r"reconstructor\.full"):
        build("reconstructor", "edit3r", full={"precision": "int8"})
