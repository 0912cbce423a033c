"""Nothing is imported from the current folder, which may be a stranger's."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import edit3r
from edit3r.kit.children import PYTHON
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.workers import Workers, run_resumable
from edit3r_testing.scenes import gaussian_cloud

ROOT = Path(edit3r.__file__).parents[1]
TRAPS = ("multiprocessing", "pip", "gaussforge", "yaml", "numba", "torch", "numpy")
SMALL = {
    "size": 24,
    "refine": 0,
    "gaussians": "all",
    "frames": 2,
    "outputs": ["scene"],
    "reconstructor": "flat",
    "rasterizer": "torch",
    "editor": "none",
}


@pytest.fixture
def trapped(tmp_path, monkeypatch):
    """The current folder, whose modules each leave a file `NAME.ran` when they are imported."""
    for name in TRAPS:
        text = f"open({str(tmp_path / name)!r} + '.ran', 'w').close()\n"
        (tmp_path / f"{name}.py").write_text(f"{text}raise ImportError('a trap')\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scene(folder):
    save_ply(folder / "scene.ply", gaussian_cloud(8))
    return ["export", "scene.ply", "--to", "spz"]


def jobs(folder):
    line = {**SMALL, "photos": [str(file) for file in packaged_pair()[0]]}
    (folder / "jobs.jsonl").write_text(json.dumps(line))
    flat = Path(__file__).parents[2] / "plugins" / "flat_scene.py"
    return ["batch", "jobs.jsonl", "--out", "out", "--plugin", str(flat)]


def weights(folder):
    return ["weights", "get", "u2netp", "--yes"]


# SECURITY.md says so, too.
needs_safe_path = pytest.mark.skipif(
    sys.version_info < (3, 11), reason="Python 3.10 knows no safe path"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [scene, pytest.param(jobs, marks=needs_safe_path), weights]
)
def test_a_command_imports_nothing_from_the_folder_it_is_started_in(trapped, command):
    paths = [str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    environment |= {"PIP_NO_INDEX": "1", "EDIT3R_WEIGHTS": str(trapped / "weights")}
    arguments = [sys.executable, "-m", "edit3r", *command(trapped)]
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True)
    assert list(trapped.glob("*.ran")) == []
    expected = 1 if command is weights else 0  # pip was started and found no package
    assert done.returncode == expected, done.stderr
    if command is weights:
        assert "pip could not fetch" in done.stderr


@needs_safe_path
def test_a_process_finds_what_the_user_put_on_the_path(tmp_path):
    (tmp_path / "mine.py").touch()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    assert (
        subprocess.run([*PYTHON, "-c", "import mine"], env=environment).returncode == 0
    )


def starts_a_script(folder):
    """A job that does what a user's own tool does: a script that imports what lies beside it."""
    command = [sys.executable, f"{folder}/tool.py"]
    done = subprocess.run(command, capture_output=True, text=True)
    return {"said": done.stdout, "safe": sys.flags.safe_path}


@pytest.mark.slow
@needs_safe_path
def test_a_worker_starts_safely_and_the_users_scripts_as_they_are(tmp_path, trapped):
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "beside.py").write_text("print('beside')")
    (tools / "tool.py").write_text("import beside")
    workers = Workers(count=1, may_die=True)
    rows = run_resumable(
        {"a": tools}, starts_a_script, tmp_path / "rows", workers=workers
    )
    assert rows["a"] == {"key": "a", "said": "beside\n", "safe": True}
    assert list(trapped.glob("*.ran")) == [] and "PYTHONSAFEPATH" not in os.environ


def test_every_process_is_started_through_one_place():
    for file in [*ROOT.glob("edit3r/**/*.py"), *ROOT.glob("plugins/**/*.py")]:
        if file.name != "children.py":
            assert "sys.executable" not in file.read_text(), file
