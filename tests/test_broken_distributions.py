"""Twelve broken or odd distributions beside the first-party one: every command works, and what
lists plugins names each.
"""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

HOOK = "from edit3r import Component, hookimpl\n\n\n@hookimpl\ndef register_editors():\n    "
MODULES = {
    "leaves": "raise SystemExit(3)\n",
    "fails": "print('hello from a plugin')\n1 / 0\n",
    "newer": f"EDIT3R_API = 99\n{HOOK}return []\n",
    "rubbish": f"{HOOK}return 'recolor'\n",
    "taken": f'{HOOK}return [Component("recolor", "taken:No", "not ours")]\n',
    "later": f"{HOOK}return []\n",
}
"""Sources of those whose module is there."""
OTHERS = {
    "nometa": "[edit3r]\nnometa = nometa\n",
    "noname": "[edit3r]\nnoname = noname\n",
    "noequals": "[edit3r]\nnoequals\n",
    "utf16": "[edit3r]\nutf16 = utf16\n",
    "stale": "[edit3r]\nstale = stale_and_gone\n",
    "nomodule": "[edit3r]\nnomodule = no-module\n",
}
"""Entry points of the others."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    for name, source in MODULES.items():
        (folder / f"{name}.py").write_text(source)
    for name in (*MODULES, *OTHERS):
        info = folder / f"{name}-1.0.dist-info"
        info.mkdir()
        points = OTHERS.get(name, f"[edit3r]\n{name} = {name}\n")
        coding = "utf-16" if name == "utf16" else "utf-8"
        (info / "entry_points.txt").write_text(points, encoding=coding)
        about = "Metadata-Version: 2.1\nVersion: 1.0\n"
        about += "" if name == "noname" else f"Name: {name}\n"
        about += "Requires-Dist: edit3r>=99\n" if name == "later" else ""
        if name != "nometa":
            (info / "METADATA").write_text(about)
    return folder


def called(site, *arguments):
    paths = (str(site), os.environ.get("PYTHONPATH", ""))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    environment.pop("EDIT3R_PLUGINS", None)
    command = [sys.executable, "-m", "edit3r", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert "Traceback" not in done.stdout + done.stderr, done.stderr
    return done


@pytest.mark.parametrize("command", ["list-plugins", "doctor"])
def test_each_is_named(command, site):
    done = called(site, command)
    assert done.returncode == (command == "doctor"), done.stdout + done.stderr
    told = done.stdout + done.stderr
    assert not [name for name in (*MODULES, *OTHERS) if name not in told]


def test_the_overview_and_the_first_command_of_the_readme_work(site, tmp_path):
    done = called(site, "--help")
    assert done.returncode == 0 and "edit photos of a scene" in done.stdout
    words = ["--prompt", "paint the bike red", "--editor", "recolor", "--guess"]
    words += ["--size", "64", "--frames", "2", "--out", str(tmp_path / "out")]
    done = called(site, "run", *words)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out/scene.ply").is_file()
