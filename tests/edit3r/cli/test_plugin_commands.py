"""A stranger's command: installed it is one like the core's own; broken it is one line, and all
else works.
"""

import os
import subprocess
import sys

import pytest
from edit3r_develop.new_plugin import new_package

from edit3r import save_ply
from edit3r_testing import gaussian_cloud


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder of installed packages: the command `scene-facts` of docs/plugins/command.md, and one
    that is broken.
    """
    folder = tmp_path_factory.mktemp("site")
    package = new_package("command", "scene-facts", tmp_path_factory.mktemp("source"))
    (package / "edit3r_scene_facts").rename(folder / "edit3r_scene_facts")
    (folder / "broken_command.py").write_text("import a_package_that_is_not_there\n")
    for name, module in (
        ("scene-facts", "edit3r_scene_facts"),
        ("broken", "broken_command"),
    ):
        info = folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n"
        )
        (info / "entry_points.txt").write_text(f"[edit3r]\n{name} = {module}\n")
    save_ply(folder / "scene.ply", gaussian_cloud(12))
    return folder


def edit3r(site, *arguments):
    path = os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "edit3r.cli.main", *arguments]
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "200"}
    return subprocess.run(
        command, cwd=site, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_a_strangers_command_is_listed_explains_itself_and_runs(site):
    assert "  scene-facts " in edit3r(site, "--help").stdout
    assert "SCENE.ply" in edit3r(site, "scene-facts", "--help").stdout
    done = edit3r(site, "scene-facts", "scene.ply")
    assert done.returncode == 0 and done.stdout.startswith(
        "12 Gaussians, harmonics of degree 1"
    ), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("scene-facts", "--scene"), "edit3r: "),
        (("scene-facts", "none.ply"), "edit3r: none.ply: no such file."),
        (("scene-fact",), "Did you mean 'scene-facts'?"),
    ],
)
def test_its_wrong_use_is_one_sentence_and_exit_code_2(site, arguments, sentence):
    done = edit3r(site, *arguments)
    assert (
        done.returncode == 2
        and done.stderr.count("\n") == 1
        and sentence in done.stderr
    )


@pytest.mark.slow
def test_a_command_plugin_that_does_not_import_is_one_line_and_nothing_else_stops(site):
    done = edit3r(site, "list-plugins")
    failed = [line for line in done.stdout.splitlines() if line.startswith("failed:")]
    assert done.returncode == 0 and len(failed) == 1
    assert (
        "plugin broken 1.0: ModuleNotFoundError: No module named 'a_package_that_is_not_there'"
        in failed[0]
    )
    assert "scene-facts" in done.stdout  # the other tests use it beside the broken one


HALF_INSTALLED = {
    ".dist-info": {},
    ".egg-info": {},
    "a-1.0.dist-info": {"entry_points.txt": b"[console_scripts]\nfoo\n"},
    "b-1.0.dist-info": {"entry_points.txt": b"[pydantic]\n = \nfoo\n"},
    "c-1.0.dist-info": {"entry_points.txt": "[edit3r]\nc = c\n".encode("utf-16")},
    "d-1.0.dist-info": {"entry_points.txt": b"[edit3r]\n\xe4 = d\n"},
    "e-1.0.dist-info": {"entry_points.txt": b"[edit3r]\ne = e\n"},
    "f-1.0.dist-info": {"entry_points.txt": b"[edit3r]\nf = f\n", "METADATA": b""},
}


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["list-plugins"], ["--help"], ["doctor", "-h"]])
def test_packages_of_others_that_are_half_installed_stop_no_command(
    arguments, tmp_path
):
    for folder, files in HALF_INSTALLED.items():
        (tmp_path / folder).mkdir()
        for name, content in files.items():
            (tmp_path / folder / name).write_bytes(content)
    command = "import sys; from edit3r.cli.program import program; sys.exit(program())"
    done = subprocess.run(
        [sys.executable, "-c", command, *arguments],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    if arguments == ["list-plugins"]:
        named = [line for line in done.stdout.splitlines() if "failed:" in line]
        assert len(named) == len(HALF_INSTALLED)
        assert all(any(f"/{one} " in line for line in named) for one in HALF_INSTALLED)
