"""`edit3r weights`, with weights that a stranger's plugin declares and a folder in the place of the
package index.
"""

import hashlib
import json
import secrets
import zipfile

import pytest

from edit3r.cli.main import main

CONTENT = b"weights" * 1000
PLUGIN = f"""
from edit3r import Component, hookimpl
from edit3r.contract.weights import Weights

FILES = (("strange/weights.bin", "{hashlib.sha256(CONTENT).hexdigest()}"),)
STRANGE = Weights("strange", "a test", 7000, "MIT", "unclear", "package:strange", "1.0", FILES)


@hookimpl
def register_editors():
    return Component("strange", "nowhere:Editor", "an editor of a stranger", weights=(STRANGE,))
"""


@pytest.fixture
def weights(tmp_path, monkeypatch):
    """The command with a stranger's plugin, as a call with the words that follow `edit3r
    weights`.
    """
    with zipfile.ZipFile(tmp_path / "strange-1.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr("strange/weights.bin", CONTENT)
        wheel.writestr(
            "strange-1.0.dist-info/METADATA",
            "Metadata-Version: 2.1\nName: strange\nVersion: 1.0\n",
        )
        wheel.writestr(
            "strange-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n"
        )
        wheel.writestr("strange-1.0.dist-info/RECORD", "")
    # a module is imported once in a process
    plugin = tmp_path / f"strange_{secrets.token_hex(4)}.py"
    plugin.write_text(PLUGIN)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path / "own"))
    return lambda *words: main(["weights", *words, "--plugin", str(plugin)])


def answer(monkeypatch, text: str) -> list[str]:
    """A user at the keyboard who answers every question with `text`; returns the questions
    asked.
    """
    asked = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr(
        "builtins.input", lambda question: asked.append(question) or text
    )
    return asked


def test_a_name_that_nobody_declares_is_an_error_with_the_near_miss(weights, capsys):
    assert weights("path", "strang") == 2
    assert "Did you mean 'strange'" in capsys.readouterr().err


@pytest.mark.slow
def test_get_shows_the_licence_asks_once_and_path_then_finds_the_file(
    weights, monkeypatch, capsys, tmp_path
):
    asked = answer(monkeypatch, "y")
    assert weights("path", "strange") == 2
    assert (
        "edit3r weights get strange (MIT; commercial use: unclear"
        in capsys.readouterr().err
    )
    assert weights("get", "strange") == 0 and len(asked) == 1
    assert "licence: MIT; commercial use: unclear" in capsys.readouterr().out
    assert weights("get", "strange") == 0 and len(asked) == 1
    capsys.readouterr()
    assert weights("path", "strange") == 0
    assert capsys.readouterr().out.strip() == str(
        tmp_path / "own" / "strange" / "weights.bin"
    )


def test_a_refused_licence_fetches_nothing(weights, monkeypatch, capsys, tmp_path):
    answer(monkeypatch, "no")
    assert weights("get", "strange") == 2
    assert "was not accepted; nothing was fetched" in capsys.readouterr().err
    assert not (tmp_path / "own").exists()


@pytest.mark.slow
def test_without_a_terminal_the_licence_is_accepted_by_a_flag_only(
    weights, capsys, tmp_path
):
    assert weights("get", "strange") == 2
    assert "edit3r weights get strange --yes" in capsys.readouterr().err
    elsewhere = str(tmp_path / "elsewhere")
    assert weights("get", "strange", "--yes", "--folder", elsewhere) == 0
    assert (tmp_path / "elsewhere" / "strange" / "weights.bin").read_bytes() == CONTENT


def test_list_tells_of_a_strangers_weights_too(weights, capsys):
    assert weights("list", "--json") == 0
    told = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert told["strange"]["commercial"] == "unclear" and told["strange"]["path"] == ""
    assert told["u2netp"]["files"]["rembg/u2netp.onnx"].startswith("309c8469")
    assert weights("list") == 0
    line = next(
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("strange ")
    )
    assert (
        "MIT" in line
        and "unclear" in line
        and "package:strange" in line
        and line.rstrip().endswith("no")
    )


def test_list_plugins_names_the_command_for_weights_that_are_missing(
    weights, capsys, tmp_path
):
    assert (
        main(
            [
                "list-plugins",
                "--kind",
                "editor",
                "--plugin",
                str(next(tmp_path.glob("*.py"))),
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert (
        "editor strange can load: edit3r weights get strange (MIT; commercial use: unclear; 0.0 MB)"
        in said
    )


def test_essentials_are_several_weights_whose_licences_are_accepted_at_once(
    weights, capsys, monkeypatch
):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert weights("get", "essentials") == 2
    said = capsys.readouterr()
    assert "accept the licences with: edit3r weights get essentials --yes" in said.err
    for name in ("u2netp", "sam2-onnx", "nanodet"):
        assert f"{name}: " in said.out
    assert "strange: " not in said.out
