"""`edit3r new-plugin`: what it writes is complete, installable and found; names are checked;
nothing is overwritten.
"""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from edit3r_develop.new_plugin import (
    STARTERS,
    check_name,
    new_package,
    next_steps,
    package_files,
)
from PIL import Image

from edit3r import load_ply
from edit3r.cli.main import main
from edit3r.contract.component import KINDS
from edit3r.contract.errors import InputError
from edit3r.kit.photos.images import packaged_pair
from edit3r_testing import CONTRACTS

FLAT = Path(__file__).parents[1] / "flat_scene.py"


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_gets_a_package_with_all_its_parts(kind):
    files = package_files(kind, "made-up")
    assert set(files) == {
        "pyproject.toml",
        "README.md",
        "edit3r_made_up/__init__.py",
        f"edit3r_made_up/{kind}.py",
        f"tests/test_{kind}.py",
    }
    project = pytest.importorskip("tomllib").loads(files["pyproject.toml"])
    assert project["project"]["entry-points"]["edit3r"] == {"made-up": "edit3r_made_up"}
    assert (
        project["project"]["license"]
        and "test" in project["project"]["optional-dependencies"]
    )
    for path, text in files.items():
        filled = text.replace("$schema=", "")  # of the YAML language server
        assert "$" not in filled, f"{path} holds an unfilled word"
        assert max(len(line) for line in text.splitlines()) <= 120
        if path.endswith(".py"):
            assert max(len(line) for line in text.splitlines()) <= 100, path
            compile(text, path, "exec")


def test_what_is_written_is_formatted_and_sorted_as_ruff_does_it(tmp_path):
    ruff = pytest.importorskip("ruff").find_ruff_bin()
    for kind in KINDS:
        for path, text in package_files(kind, "made-up").items():
            if path.endswith(f"{kind}.py"):
                (tmp_path / path.replace("/", "-")).write_text(text)
    for check in (["format", "--check"], ["check", "--select", "E4,E7,E9,F,I,UP"]):
        # in a folder of its own edit3r is a package of others, as it is for the author
        command = [ruff, *check, "--isolated", "."]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


def test_there_is_a_starter_and_a_contract_for_every_kind():
    assert set(STARTERS) == set(CONTRACTS) == set(KINDS)
    for kind, starter in STARTERS.items():
        assert CONTRACTS[kind].__name__ == f"{starter['suffix']}Contract"


@pytest.mark.parametrize(
    "name, hint",
    [
        ("Sepia", "'sepia'"),
        ("warmLight", "'warm-light'"),
        ("my editor", "'my-editor'"),
        ("2d", "'d'"),
        ("a_b", "'a-b'"),
        ("a--b", "'a-b'"),
        ("-a", "'a'"),
        ("", "'my-plugin'"),
        ("../up", "'up'"),
        ("é", "'my-plugin'"),
        ("x" * 41, "at most 40"),
        ("class", "keyword"),
        ("editors", "already installed"),
    ],
)
def test_a_bad_name_is_refused_with_a_better_one(name, hint):
    with pytest.raises(InputError, match=hint):
        check_name(name)


def test_nothing_is_overwritten(tmp_path):
    there = tmp_path / "edit3r-sepia-tone"
    there.mkdir()
    (there / "mine.txt").write_text("precious")
    with pytest.raises(InputError, match="nothing was written"):
        new_package("editor", "sepia-tone", tmp_path)
    assert [path.name for path in tmp_path.rglob("*")] == [
        "edit3r-sepia-tone",
        "mine.txt",
    ]


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "edit3r_develop.new_plugin.shutil.move",
        lambda *_: (_ for _ in ()).throw(OSError("disk full")),
    )
    with pytest.raises(OSError, match="disk full"):
        new_package("editor", "sepia-tone", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_and_says_what_to_do_next(tmp_path, capsys):
    assert main(["new-plugin", "editor", "sepia-tone", "--path", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "edit3r_sepia_tone/editor.py" in said
    for step in next_steps("editor", "sepia-tone", tmp_path / "edit3r-sepia-tone"):
        assert step in said
    assert main(["new-plugin", "editor", "sepia-tone", "--path", str(tmp_path)]) == 2


def test_a_name_that_an_installed_component_has_is_refused(tmp_path, capsys):
    assert main(["new-plugin", "editor", "none", "--path", str(tmp_path)]) == 2
    assert "already offered by plugin 'editors'" in capsys.readouterr().err


def test_a_run_takes_the_new_folder_as_it_is_without_installing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(f"{name}.png")
    assert main(["new-plugin", "editor", "made-here"]) == 0
    run = (
        f"run a.png b.png --editor made-here --plugin edit3r-made-here --plugin {FLAT}"
    )
    parts = "--recon flat --rasterizer torch --size 24 --refine 0 --gaussians all"
    assert main(f"{run} {parts} --outputs scene --quiet --out out".split()) == 0
    facts = json.loads(Path("out/run.json").read_text())
    used = {(one["kind"], one["name"], one["plugin"]) for one in facts["plugins"]}
    assert ("editor", "made-here", "edit3r_made_here") in used
    assert load_ply("out/scene.ply").count > 0


@pytest.mark.slow
def test_the_wheel_installs_beside_edit3r_is_listed_and_passes_its_test(tmp_path):
    """Built with its own build backend and unpacked as pip does; all in fresh processes."""
    folder = new_package("editor", "sepia-tone", tmp_path)
    site = tmp_path / "site"
    environment = {**os.environ, "PYTHONPATH": str(site)}

    def python(*arguments: str, cwd: Path = tmp_path) -> str:
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    python(
        "-c",
        f"import hatchling.build as b; b.build_wheel({str(tmp_path)!r})",
        cwd=folder,
    )
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(site)
    listed = json.loads(
        python(
            "-m",
            "edit3r.cli.main",
            "list-plugins",
            "--json",
            "--kind",
            "editor",
        )
    )
    (row,) = [row for row in listed["components"] if row["name"] == "sepia-tone"]
    assert (row["plugin"], row["version"], row["problem"], row["missing"]) == (
        "sepia-tone",
        "0.1.0",
        "",
        "",
    )
    python(
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:xdist",
        "-p",
        "no:cacheprovider",
        str(folder / "tests"),
    )
