"""The example that edits a splat."""

from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

from edit3r.kit.scenes.ply import load_ply, save_ply
from tests.plugins.scan import scan

SCRIPT = Path(__file__).parents[2] / "examples" / "edit_splat.py"
example = SourceFileLoader("edit_splat", str(SCRIPT)).load_module()


@pytest.mark.slow
def test_a_splat_is_edited_and_counted(tmp_path):
    save_ply(tmp_path / "scan.ply", scan())
    out = tmp_path / "out"
    quick = {"size": 48, "views": 4, "outputs": ("scene",)}
    sentence = "make everything black and white"
    count = example.edit(str(tmp_path / "scan.ply"), sentence, str(out), **quick)
    before, after = scan(), load_ply(out / "scene.ply")
    differs = (before.harmonics != after.harmonics).flatten(2).any(2)
    assert count == int(differs.sum()) > 600
