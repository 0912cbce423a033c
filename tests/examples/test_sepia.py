"""The example package, installed by pip as a stranger would and used through the commands."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

PACKAGE = Path(__file__).parents[2] / "examples" / "edit3r-sepia"


def run(*command: str, site: Path | None = None) -> subprocess.CompletedProcess:
    """A command in this Python, with `site` on its path as an installed package's folder would be."""
    paths = [str(site)] if site else []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, env=environment, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder with the package and its entry point, made by pip without touching this installation."""
    pytest.importorskip("hatchling", reason="the package builds with hatchling, part of edit3r's test extra")
    folder = tmp_path_factory.mktemp("site")
    run("-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", str(folder), str(PACKAGE))
    return folder


def test_the_installed_package_is_listed(site):
    listed = run("-m", "edit3r.cli.main", "list-plugins", "--kind", "editor", "--json", site=site).stdout
    assert '"sepia"' in listed


def test_edit3r_run_uses_the_installed_editor(site, tmp_path):
    run(
        *("-m", "edit3r.cli.main", "run", "--editor", "sepia", "--recon", "classical", "--size", "96"),
        *("--frames", "2", "--out", str(tmp_path / "out")),
        site=site,
    )
    edited = sorted((tmp_path / "out" / "edited").iterdir())
    assert len(edited) == 2
    red, _, blue = np.asarray(Image.open(edited[0]).convert("RGB"), dtype=float).transpose(2, 0, 1)
    assert (red >= blue).mean() > 0.999  # PNG or JPEG, sepia has no blue


def test_its_own_tests_pass(site):
    run("-m", "pytest", "-q", "-p", "no:cacheprovider", str(PACKAGE / "tests"), site=site)
