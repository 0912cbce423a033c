"""The gallery of edited scenes: one card a scene, whose image moves."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from edit3r_outputs.video import save_video
from PIL import Image

from edit3r.cli.main import main

SCRIPT = Path(__file__).parents[2] / "docs/gallery.py"
spec = importlib.util.spec_from_file_location("docs_gallery", SCRIPT)
gallery = importlib.util.module_from_spec(spec)
spec.loader.exec_module(gallery)


@pytest.fixture
def made(monkeypatch, tmp_path):
    """The folder of a gallery whose runs are pretended."""
    frames = [np.full((60, 80, 3), shade, np.uint8) for shade in (0, 120, 240)]

    def run(command, cwd, check):
        folder = Path(command[command.index("--out") + 1])
        folder.mkdir()
        save_video(folder / "video.webm", frames)
        verdicts = {
            "verdict": {"label": "good"},
            "edit_verdict": {"label": "doubtful"},
            "selection_verdict": None,
        }
        (folder / "run.json").write_text(json.dumps(verdicts))

    monkeypatch.setattr(gallery.subprocess, "run", run)
    monkeypatch.setattr(sys, "argv", ["gallery.py", str(tmp_path / "out")])
    gallery.main()
    return tmp_path / "out"


def test_every_scene_has_a_card_with_its_verdicts(made):
    page = (made / "index.html").read_text()
    said = page.count("selected: all of it, edit: doubtful, scene: good")
    assert said == len(gallery.EDITS)
    for edit in gallery.EDITS:
        assert f'href="{edit.name}/viewer.html"' in page and edit.prompt in page


def test_the_images_show_every_frame(made):
    with Image.open(made / "blue.webp") as image:
        assert image.n_frames == 3 and image.width == gallery.WIDTH


@pytest.mark.parametrize("edit", gallery.EDITS, ids=lambda edit: edit.name)
def test_the_commands_are_right_up_to_the_photos(edit, tmp_path, capsys):
    words = [
        *edit.command[1:],
        str(tmp_path / "none.png"),
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(words) == 2
    assert "no such file" in capsys.readouterr().err
