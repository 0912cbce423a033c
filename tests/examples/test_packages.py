"""The example packages, installed by pip as a stranger would and used through the commands."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"
PACKAGES = {
    "edit3r-sepia": "sepia",
    "edit3r-program": "program",
    "edit3r-ffgs": "ffgs",
    "edit3r-vggt": "vggt",
}
"""Each package and the component it brings."""


def run(*command: str, site: Path | None = None) -> subprocess.CompletedProcess:
    """A command in this Python, with `site` on its path as an installed package's folder would
    be.
    """
    paths = [str(site)] if site else []
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")]),
    }
    done = subprocess.run(
        [sys.executable, *command],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder with the packages and their entry points, made by pip without touching this
    installation.
    """
    pytest.importorskip(
        "hatchling",
        reason="the packages build with hatchling, part of edit3r's test extra",
    )
    folder = tmp_path_factory.mktemp("site")
    sources = [str(EXAMPLES / package) for package in PACKAGES]
    run(
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--target",
        str(folder),
        *sources,
    )
    return folder


def test_every_example_package_is_tried_here():
    assert {folder.parent.name for folder in EXAMPLES.glob("*/pyproject.toml")} == set(
        PACKAGES
    )


def test_the_installed_packages_are_listed_with_their_licences_and_weights(site):
    listed = run("-m", "edit3r.cli.main", "list-plugins", "--json", site=site).stdout
    assert all(f'"{component}"' in listed for component in PACKAGES.values())
    weights = run(
        "-m", "edit3r.cli.main", "weights", "list", "--json", site=site
    ).stdout
    assert '"anysplat"' in weights and "CC BY-NC 4.0" in weights


def test_edit3r_run_uses_the_installed_editor_and_a_program_as_reconstructor(
    site, tmp_path
):
    tool = EXAMPLES / "edit3r-program" / "tests" / "tool.py"
    command = f"'{sys.executable}' '{tool}' {{photos}} {{result}}"
    words = ["run", "--editor", "sepia", "--recon", "program", "--size", "64"]
    words += ["--set", f"reconstructor.command={command}", "--frames", "2"]
    words += ["--rasterizer", "torch", "--refine", "0", "--out", str(tmp_path / "out")]
    run("-m", "edit3r.cli.main", *words, site=site)
    assert (tmp_path / "out" / "scene.ply").is_file()
    edited = sorted((tmp_path / "out" / "edited").iterdir())
    assert len(edited) == 2
    red, _, blue = np.asarray(
        Image.open(edited[0]).convert("RGB"), dtype=float
    ).transpose(2, 0, 1)
    assert (red >= blue).mean() > 0.999  # PNG or JPEG, sepia has no blue


def test_their_own_tests_pass(site):
    tried = [
        package
        for package in PACKAGES
        if package != "edit3r-ffgs" or importlib.util.find_spec("ffgs")
    ]
    tests = [str(EXAMPLES / package / "tests") for package in tried]
    alone = ("-n", "0", "-p", "no:cacheprovider")  # one process is enough
    run("-m", "pytest", "-q", *alone, *tests, site=site)
