"""Outlines drawn by hand: the file holds what it promises."""

import json
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_photos_that_are_there_are_not_fetched_again(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    fetch = runpy.run_path(str(ROOT / "benchmarks/outlines.py"))["fetch"]
    asked = []
    answer = lambda source, clones: asked.append(source["path"]) or b"photo"  # noqa: E731
    monkeypatch.setitem(fetch.__globals__, "content", answer)
    told = [*fetch(tmp_path)]
    count = len(asked)
    assert not [*fetch(tmp_path)] and len(told) == count
    assert count > 50 and len(asked) == count


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
