"""Schemas say what the loaders take: every example and every shipped file, and no misspelt key."""

import copy
import json
import re
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator

from edit3r.cli.main import find_command
from edit3r.loading.describe import described
from edit3r.loading.registry import default_registry
from edit3r.loading.schema import configuration_schema
from edit3r.running.config import RunConfig

ROOT = Path(__file__).parents[3]
BLOCK = re.compile(r"^```yaml\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def validators():
    """By command, a validator of its configuration files."""
    registry = default_registry()
    return {
        name: Draft202012Validator(
            configuration_schema(
                registry,
                find_command(name).configuration(),
                name,
                {"run": RunConfig},
            )
        )
        for name in ("run", "train", "bench")
    }


def shipped():
    """(command, where, content) of every YAML in configs/ and on the pages."""
    for command, folder in (("train", "training"), ("bench", "bench")):
        for file in sorted((ROOT / "configs" / folder).rglob("*.yaml")):
            yield command, file.name, yaml.safe_load(file.read_text(encoding="utf-8"))
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    for page in sorted(pages):
        for index, block in enumerate(BLOCK.findall(page.read_text(encoding="utf-8"))):
            content = yaml.safe_load(block)
            of_training = {"train_data", "losses", "trainer"} & content.keys()
            yield "train" if of_training else "run", f"{page.name}-{index}", content


SHIPPED = list(shipped())


@pytest.mark.slow  # imports every component
@pytest.mark.parametrize(("command", "where", "content"), SHIPPED)
def test_every_shipped_configuration_fits_its_schema(
    command, where, content, validators
):
    schema = validators[command]
    missing = {error.validator for error in schema.iter_errors(content)}
    # A page may show a part of a file.
    assert missing <= ({"required"} if where.split(".")[-1] != "yaml" else set())


def misspelt(content):
    """Copies of a configuration, each with one key spelt wrong."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key != "methods":
                yield {f"{k}x" if k == key else k: v for k, v in content.items()}
            for inner in misspelt(value):
                yield {**content, key: inner}
    if isinstance(content, list):
        for index, value in enumerate(content):
            for inner in misspelt(value):
                yield [*content[:index], inner, *content[index + 1 :]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "file"),
    [
        ("train", "training/edit3r-small.yaml"),
        ("train", "training/edit3r-small-rendered.yaml"),
        ("bench", "bench/offline.yaml"),
    ],
)
def test_a_misspelt_key_is_refused_wherever_it_stands(command, file, validators):
    content = yaml.safe_load((ROOT / "configs" / file).read_text(encoding="utf-8"))
    for wrong in misspelt(copy.deepcopy(content)):
        assert not validators[command].is_valid(wrong), wrong


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        {"sise": 512},
        {"size": "large"},
        {"size": 4},
        {"editor": {"name": "recolor", "strenth": 1}},
        {"editor": "recolour"},
        {"refiners": [{"name": "simplify", "prize": 1}]},
        {"reconstructor": {"name": "edit3r", "backbone": {"name": "no-such"}}},
        {"writer": {"video": {"fpss": 30}}},
        {"quality": "worst"},
    ],
)
def test_what_a_run_refuses_its_schema_refuses(wrong, validators):
    assert not validators["run"].is_valid(wrong)


@pytest.mark.slow
@pytest.mark.parametrize(
    "right",
    [
        {"outputs": "all"},
        {"outputs": ["scene", {"name": "video", "fps": 30}]},
        {"editor": {"name": "recolor:recolor"}},
        {"matcher": {"name": "classical", "planes": 32}},
        {"editor": None, "fov": None},
    ],
)
def test_what_a_run_takes_its_schema_takes(right, validators):
    assert validators["run"].is_valid(right)


@pytest.mark.slow
@pytest.mark.parametrize(
    "offer", default_registry().offers(), ids=lambda o: f"{o.kind}-{o.component.name}"
)
def test_what_describe_shows_as_json_fits_its_own_schema(offer):
    if offer.kind == "command" or default_registry().missing(offer):
        pytest.skip("has no settings, or is not installed here")
    text = json.loads(json.dumps(described(default_registry(), offer)))
    Draft202012Validator.check_schema(text["settings"])
    schema = {**text["settings"], "required": []}
    Draft202012Validator(schema).validate(text["example"])
