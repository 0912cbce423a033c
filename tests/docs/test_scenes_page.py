"""The page of scenes to walk through: built with the site, and drawn by a real browser."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.loading.registry import build

from .test_gallery import gallery

ROOT = Path(__file__).parents[2]
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
VERDICTS = {
    "verdict": {"label": "good"},
    "edit_verdict": {"label": "doubtful"},
    "selection_verdict": None,
}


def pretended(command, cwd, check):
    """A run that leaves a viewer of a few Gaussians."""
    folder = Path(command[command.index("--out") + 1])
    folder.mkdir()
    draw = torch.Generator().manual_seed(0)
    means = torch.randn(1, 200, 3, generator=draw) + torch.tensor([0, 0, 5.0])
    colours = colour_to_dc(torch.rand(1, 200, 1, 3, generator=draw))
    quats = torch.tensor([1.0, 0, 0, 0]).expand(1, 200, 4)
    scene = SceneToWrite(
        Gaussians(
            means, torch.full_like(means, 0.2), quats, torch.ones(1, 200), colours
        ),
        Cameras(torch.eye(4)[None, None], torch.eye(3)[None, None], (60, 90)),
    )
    build("writer", "viewer").write(folder / "viewer.html", scene)
    (folder / "run.json").write_text(json.dumps(VERDICTS))


@pytest.fixture
def copied(monkeypatch, tmp_path):
    """The documents of a checkout, with the scenes of the gallery in them."""
    ours = shutil.ignore_patterns("scenes", "__pycache__")
    shutil.copytree(ROOT / "docs", tmp_path / "docs", ignore=ours)
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    monkeypatch.setattr(gallery.subprocess, "run", pretended)
    line = ["gallery.py", str(tmp_path / "docs/scenes"), "--pages"]
    monkeypatch.setattr(sys, "argv", line)
    gallery.main()
    monkeypatch.undo()
    return tmp_path


def test_the_gallery_leaves_one_file_a_scene_and_what_is_said_of_it(copied):
    names = {edit.name for edit in gallery.EDITS if edit.on_site}
    left = {file.name for file in (copied / "docs/scenes").iterdir()}
    assert len(names) == 6
    assert left == {"scenes.json", *(f"{name}.html" for name in names)}
    said = json.loads((copied / "docs/scenes/scenes.json").read_text())
    assert {one["name"] for one in said} == names
    for one in said:
        verdicts = (one["selected"], one["edit"], one["scene"])
        assert verdicts == ("all of it", "doubtful", "good")


def test_every_photo_of_the_site_ships():
    for edit in gallery.EDITS:
        assert all((gallery.ROOT / photo).is_file() for photo in edit.photos)


@pytest.mark.slow
@pytest.mark.skipif(
    CHROMIUM is None, reason="needs the program chromium: apt-get install chromium"
)
def test_the_site_builds_without_complaint_and_all_six_scenes_are_drawn(copied):
    playwright = pytest.importorskip("playwright.sync_api")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    built = subprocess.run(command, cwd=copied, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as manager:
        browser = manager.chromium.launch(executable_path=CHROMIUM, args=flags)
        page = browser.new_page(viewport={"width": 1000, "height": 800})
        page.goto((copied / "site/scenes/index.html").as_uri())
        frames = page.locator("iframe")
        assert frames.count() == 6
        page.locator("iframe[src]").first.wait_for()
        assert page.locator("iframe[src]").count() == 1  # the one that is looked at
        for number in range(6):
            frames.nth(number).scroll_into_view_if_needed()
            inside = frames.nth(number).content_frame
            inside.locator("body[data-drawn]").wait_for(timeout=60_000)
        browser.close()


@pytest.mark.slow
def test_without_scenes_the_site_builds_too_and_says_so(copied):
    shutil.rmtree(copied / "docs/scenes")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet"]
    built = subprocess.run(command, cwd=copied, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    page = (copied / "site/scenes/index.html").read_text()
    assert "not in this copy" in page and "<iframe" not in page
