"""`edit3r describe` and the words it uses; the YAML it prints is what a configuration accepts."""

import json
from enum import Enum
from pathlib import Path
from typing import Any, Literal

import pytest
import yaml
from pydantic import Field

from edit3r.cli.main import main
from edit3r.contract.settings import PartChoice, Settings
from edit3r.loading.describe import settings_lines, type_in_words, yaml_example
from edit3r.loading.registry import default_registry
from edit3r.running.config import PART_KEYS, make_run_config

LOCAL = """
from pydantic import Field

from edit3r import Component, Settings, hookimpl


class Thing:
    class Settings(Settings):
        strength: float = Field(0.25, gt=0, le=1, description="how much: all of it at 1")
        mode: str = Field("yes", description="a word that YAML would take for a truth value")


@hookimpl
def register_editors():
    facts = {"citation": "Doe 2026", "devices": ("cuda",)}
    return [Component("described", "described_locally:Thing", "a thing", **facts)]


@hookimpl
def register_heads():
    needs = ("surely_not_there",)
    return [Component("needy", "described_locally:Thing", "needs much", requires=needs)]
"""


class Way(Enum):
    soft = "soft"
    no = "no"


class Everything(Settings):
    way: Way = Field(Way.no, description="a way")
    place: Path = Field(Path("a/b"), description="a place")
    both: frozenset[str] = Field(frozenset({"a"}), description="both")
    count: int | None = Field(None, ge=1, lt=9, description="a count")
    choice: Literal["a", "b"] = Field("a", description="a choice")
    weights: tuple[float, float] = Field((1.0, 1e-6), description="weights")
    names: tuple[str, ...] = Field((), description="names")
    part: PartChoice = Field(
        PartChoice(name="vit", settings={"width": 8}), description="a part"
    )
    table: dict[str, float] = Field(
        default_factory=dict, description="a table: of numbers # not a comment"
    )
    flag: bool = Field(True, description="a flag")
    step: int = Field(8, multiple_of=8, description="steps")


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    file = tmp_path_factory.mktemp("local") / "described_locally.py"
    file.write_text(LOCAL)
    return str(file)


@pytest.mark.parametrize(
    "annotation, words",
    [
        (float, "float"),
        (int | None, "int or null"),
        (Literal["a", "b"], "a | b"),
        (tuple[float, float, float], "list of 3 float"),
        (tuple[str, ...], "list of text"),
        (dict[str, float], "mapping of text to float"),
        (PartChoice, "component"),
        (bool, "true or false"),
        (Way, "soft | 'no'"),
        (Any, "anything"),
    ],
)
def test_types_in_words(annotation, words):
    assert type_in_words(annotation) == words


def test_ranges_and_defaults_in_words():
    lines = {line.name: line for line in settings_lines(Everything)}
    assert lines["count"].range == "≥ 1, < 9"
    assert lines["step"].range == "multiple of 8"
    assert lines["count"].default_yaml == "null"
    assert lines["weights"].default_yaml == "[1.0, 1.0e-06]"
    assert lines["part"].default_yaml == "{name: vit, width: 8}"
    assert lines["table"].default_yaml == "{}"


def test_every_type_of_setting_survives_its_yaml():
    offer = default_registry().find("editor", "none")
    values = yaml.safe_load(yaml_example(offer, Everything))["editor"]
    assert values.pop("name") == "none"
    assert Everything(**values) == Everything()


@pytest.mark.parametrize(
    "offer",
    default_registry().offers(),
    ids=lambda offer: f"{offer.kind}-{offer.component.name}",
)
def test_the_yaml_of_every_component_is_its_defaults(offer):
    registry = default_registry()
    if registry.missing(offer):
        pytest.skip(f"needs {', '.join(registry.missing(offer))}")
    settings = registry.settings_class(offer)
    content = yaml.safe_load(yaml_example(offer, settings))
    if offer.kind in PART_KEYS:
        make_run_config(content)  # a run accepts it
    if "reconstructor" in content and offer.kind != "reconstructor":
        content = content["reconstructor"]
    values = content["refiners"][0] if offer.kind == "refiner" else content[offer.kind]
    assert values.pop("name") == offer.component.name
    required = {
        line.name: "given" for line in settings_lines(settings) if line.required
    }
    assert settings(**{**values, **required}) == settings(**required)


def test_all_there_is_to_know_is_shown(local, capsys):
    assert main(["describe", "editor", "described", "--plugin", local]) == 0
    said = capsys.readouterr().out
    for words in (
        "a thing",
        "(not installed)",
        "Doe 2026",
        "strength = 0.25",
        "float, > 0, ≤ 1",
        "how much: all of it at 1",
    ):
        assert words in said
    assert "runs on                 cuda" in said
    assert "--set editor.strength=0.25" in said
    assert main(["describe", "backbone", "asymmetric-vit"]) == 0
    assert "--set reconstructor.backbone." in capsys.readouterr().out


def test_a_refiner_is_one_of_a_list_and_a_command_has_arguments(tmp_path, capsys):
    from edit3r_develop.new_plugin import new_package

    package = str(
        new_package("refiner", "described-refiner", tmp_path)
        / "edit3r_described_refiner"
    )
    assert main(["describe", "refiner", "described-refiner", "--plugin", package]) == 0
    said = capsys.readouterr().out
    assert "refiners:\n  - name: described-refiner\n    least_opacity: 0.02" in said
    assert "--set 'refiners=[{name: described-refiner, least_opacity: 0.02}]'" in said
    assert main(["describe", "command", "simplify"]) == 0
    said = capsys.readouterr().out
    assert "edit3r simplify --help" in said and "YAML" not in said


def test_a_setting_without_default_is_told_to_be_required():
    class Rooted(Settings):
        root: str = Field(description="folder")

    (line,) = settings_lines(Rooted)
    assert line.required and line.allowed == "text, required"
    example = yaml_example(default_registry().find("dataset", "procedural"), Rooted)
    assert "root: null" in example and "folder (text, required)" in example


def test_what_is_not_installed_is_described_as_far_as_known(local, capsys):
    assert main(["describe", "head", "needy", "--plugin", local]) == 0
    assert "pip install surely_not_there" in capsys.readouterr().out


def test_an_unknown_name_ends_with_2_and_a_hint(capsys):
    assert main(["describe", "editor", "recolour"]) == 2
    assert "Did you mean 'recolor'?" in capsys.readouterr().err


def test_weights_are_told_with_licence_size_and_that_they_are_gated(capsys):
    assert main(["describe", "segmenter", "sam3"]) == 0
    said = capsys.readouterr().out
    assert (
        "edit3r weights get sam3 (SAM License" in said
        and "gated: needs an account" in said
    )


def test_a_plugins_text_gives_the_terminal_no_commands(tmp_path, capsys):
    summary = "a thing\\x1b[2J\\x1b]0;title\\x07"
    local = LOCAL.replace('"a thing"', f'"{summary}"').replace(
        "described_locally", "described_rudely"
    )
    (tmp_path / "described_rudely.py").write_text(local)
    plugin = str(tmp_path / "described_rudely.py")
    assert main(["describe", "editor", "described", "--plugin", plugin]) == 0
    shown = capsys.readouterr().out
    assert "a thing" in shown and "strength = 0.25" in shown
    assert all(one.isprintable() for one in shown.replace("\n", ""))


def test_as_json_it_says_what_it_is_and_what_it_takes(capsys):
    assert main(["describe", "editor", "recolor", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["settings"]["properties"].keys() == content["example"].keys()
    assert content["about"]["licence"] == "Apache-2.0"


def test_the_schema_of_a_command_without_a_configuration_is_refused(capsys):
    assert main(["schema", "simplify"]) == 2
    assert "edit3r simplify reads no configuration file" in capsys.readouterr().err
