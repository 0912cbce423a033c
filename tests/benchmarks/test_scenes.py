"""No setting is chosen by the scenes that are held out."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
held_out = runpy.run_path(str(ROOT / "benchmarks/harness.py"))


@pytest.mark.parametrize("scene", held_out["HELD_OUT"])
def test_a_held_out_scene_ends_what_settings_are_tuned_by(scene):
    with pytest.raises(SystemExit, match=scene):
        held_out["for_tuning"](["photos/fern", f"photos/{scene}/"])
    assert held_out["for_tuning"](["photos/fern"]) == ["photos/fern"]
    notes = (ROOT / "docs/notes/scenes.md").read_text(encoding="utf-8")
    assert f"`{scene}`" in notes.split("## Held out")[1]


@pytest.mark.parametrize("script", ["poses.py", "scenes.py", "verdict.py"])
def test_benchmarks_that_tune_ask_before_they_read_folders(script):
    code = (ROOT / "benchmarks" / script).read_text(encoding="utf-8")
    assert re.search(r"for_tuning\(\S*\b(folders|sources)\)", code)
