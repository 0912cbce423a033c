"""No file names a program or an address without `--trust-config`. Every door is tried."""

import json
from pathlib import Path

import pytest
import yaml
from PIL import Image

from edit3r.cli.main import main
from edit3r.contract.settings import is_user_only
from edit3r.kit.photos.images import packaged_pair
from edit3r.loading.registry import default_registry

PLUGIN = str(Path(__file__).with_name("calling.py"))
FLAT = str(Path(__file__).parents[2] / "plugins" / "flat_scene.py")
CHOICE = {"name": "calling", "program": "mark"}


@pytest.fixture
def mark(tmp_path, monkeypatch):
    """A file that exists once the program was called; the folder holds photos."""
    monkeypatch.chdir(tmp_path)
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(f"{name}.png")
    return tmp_path / "mark"


def write(name, content):
    text = yaml.safe_dump(content) if name.endswith("yaml") else json.dumps(content)
    Path(name).write_text(text)


def by_run():
    write("c.yaml", {"editor": CHOICE})
    return "run a.png b.png --config c.yaml --quiet --out out"


def by_a_file_beside_a_flag():
    write("c.yaml", {"editor": {"program": "mark"}})
    return "run a.png b.png --editor calling --config c.yaml --quiet --out out"


def by_an_earlier_run():
    small = "--size 24 --frames 2 --refine 0 --gaussians all --outputs scene,images"
    parts = f"--editor none --recon flat --rasterizer torch --plugin {FLAT}"
    assert main(f"run a.png b.png {small} {parts} --quiet --out first".split()) == 0
    manifest = json.loads(Path("first/run.json").read_text())
    chosen = {"name": "calling", "settings": {"program": "mark"}}
    manifest["settings"]["run"]["reconstructor"] = chosen
    write("first/run.json", manifest)
    return "run --from first --editor none --quiet --out out"


def by_a_job():
    write("jobs.jsonl", {"photos": ["a.png", "b.png"], "editor": CHOICE})
    return "batch jobs.jsonl --quiet --out out"


def by_the_config_of_jobs():
    write("jobs.jsonl", {"photos": ["a.png", "b.png"]})
    write("c.yaml", {"editor": CHOICE})
    return "batch jobs.jsonl --config c.yaml --quiet --out out"


def by_training():
    config = {"reconstructor": "classical", "train_data": CHOICE, "out": "out"}
    write("c.yaml", config)
    return "train c.yaml"


def by_a_benchmark():
    build = "bench build --procedural 1 --out m.json --size 32 --views 2 --quiet"
    assert main(build.split()) == 0
    write("c.yaml", {"methods": [{"label": "x", "reconstructor": CHOICE}]})
    return (
        "bench run m.json --config c.yaml --edits 1 --no-effnet --quiet --out results"
    )


DOORS = [
    by_run,
    by_a_file_beside_a_flag,
    by_an_earlier_run,
    by_a_job,
    by_the_config_of_jobs,
    by_training,
    by_a_benchmark,
]


@pytest.mark.slow
@pytest.mark.parametrize("door", DOORS)
def test_a_file_names_a_program_only_with_consent(door, mark, capsys, forked_workers):
    command = [*door().split(), "--plugin", PLUGIN]
    assert main(command) != 0
    said = capsys.readouterr().err
    assert "may not give this setting" in said and "--trust-config" in said
    assert not mark.exists() and not Path("out").exists()
    if door is not by_the_config_of_jobs:  # as `by_a_job`, which waits for a worker
        main([*command, "--trust-config"])
        assert mark.exists()


def test_what_the_user_says_stands_over_the_file(mark, capsys):
    command = [*by_run().split(), "--plugin", PLUGIN]
    main([*command, "--set", "editor.program=mark"])
    assert mark.exists() and "--trust-config" not in capsys.readouterr().err


def test_whatever_names_a_program_or_an_address_is_for_the_user_alone():
    registry = default_registry()
    marked = []
    for offer in registry.offers():
        if registry.missing(offer):
            continue
        for name, field in registry.settings_class(offer).model_fields.items():
            if name in ("command", "program", "base_url", "url", "address", "host"):
                assert is_user_only(field), (offer.qualified_name, name)
                marked.append(f"{offer.component.name}.{name}")
    assert {"command.command", "gpt-image.base_url", "gemini-image.base_url"} <= {
        *marked
    }
