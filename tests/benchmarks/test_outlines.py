"""Outlines drawn by hand: the tool keeps what was drawn, and the file holds what it promises."""

import json
import runpy
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
SCRIPT = str(ROOT / "benchmarks/outlines.py")
PHOTO = "scene/images/0.png"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """The tool on a photo of 40 x 30 pixels, with a file of its own."""
    (tmp_path / PHOTO).parent.mkdir(parents=True)
    Image.new("RGB", (40, 30)).save(tmp_path / PHOTO)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["outlines.py", str(tmp_path), *words])
        main = runpy.run_path(SCRIPT)["main"]
        main.__globals__["FILE"] = tmp_path / "outlines.json"
        main()

    return call


def test_an_outline_is_kept_with_its_hole_and_its_word(run, tmp_path):
    outline, hole = "0,0 9,0 9,9.25 0,9", "3,3 6,3 6,6 3,6"
    run("add", "scene/pot", PHOTO, outline, "--hole", hole, "--word", "plant pot")
    pot = json.loads((tmp_path / "outlines.json").read_text())["scene/pot"]
    assert pot["word"] == "plant pot"
    assert pot["photos"][PHOTO][0] == [[0, 0], [9, 0], [9, 9.2], [0, 9]]
    assert len(pot["photos"][PHOTO]) == 2


def test_a_check_shows_the_outline_on_the_enlarged_photo(run, tmp_path):
    run("add", "scene/pot", PHOTO, "15,15 25,15 25,25 15,25")
    out = tmp_path / "check.png"
    run("check", "scene/pot", "--zoom", "4", "--out", str(out))
    shown = Image.open(out)
    assert shown.size == ((25 + 12 - 3) * 4, (30 - 3) * 4)
    assert shown.getpixel(((20 - 3) * 4, (15 - 3) * 4 + 2)) == (255, 0, 0)


def test_every_outline_of_the_file_has_a_word_and_rings_that_enclose_something():
    objects = json.loads((ROOT / "benchmarks/outlines.json").read_text())
    assert len(objects) >= 55
    for name, entry in objects.items():
        assert entry["word"] and "/" in name
        for rings in entry["photos"].values():
            assert all(len(ring) >= 4 for ring in rings), name


def test_whole_scenes_are_held_out_and_they_are_a_third():
    objects = json.loads((ROOT / "benchmarks/outlines.json").read_text())
    scenes: dict[str, list[bool]] = {}
    for entry in objects.values():
        scene = next(iter(entry["photos"])).split("/")[0]
        scenes.setdefault(scene, []).append(entry.get("held_out", False))
    assert all(len(set(held)) == 1 for held in scenes.values())
    held_out = sum(sum(held) for held in scenes.values())
    assert abs(held_out / len(objects) - 1 / 3) < 0.03
