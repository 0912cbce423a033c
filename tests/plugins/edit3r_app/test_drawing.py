"""What is drawn over a scene is kept, grown and taken back, and told as bits."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_app import drawing as module
from edit3r_app.drawing import MOST_GROWN, Drawing
from edit3r_app.jobs import JobsFolder

from edit3r import save_ply
from edit3r.contract.errors import InputError
from edit3r.kit.scenes.axes import LEAST_OPACITY
from edit3r.loading.registry import default_registry
from tests.plugins.scan import scan

STROKE = {
    "kind": "lasso",
    "places": [[0, 0], [0.5, 0], [0.5, 1]],
    "right": [1, 0, 0],
    "down": [0, 1, 0],
    "forward": [0, 0, 1],
    "centre": [0, 0, 0],
    "lens": [0.9, 1.35, 0.5, 0.5],
    "aspect": 1.5,
}
OPACITIES = LEAST_OPACITY * torch.tensor([1.5, 0.5, 2.0] * 7)[None]


def fewest(gaussians, strokes, rasterizer, grown):
    """Three Gaussians for each stroke, the first ones, and one for each step."""
    return torch.arange(gaussians.count) < 3 * len(strokes) + grown


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "choose_drawn", fewest)
    monkeypatch.setattr(module, "load_ply", lambda path, visible: made)
    made = replace(scan().select(torch.arange(21)), opacities=OPACITIES)
    for run in ("jar", "empty"):
        (tmp_path / run).mkdir()
    save_ply(tmp_path / "jar" / "scene.ply", made)
    return JobsFolder(tmp_path)


def change(folder, do, value=None, run="jar"):
    told = Drawing(folder, default_registry()).change(run, {"do": do, "value": value})
    return told["strokes"], told["grown"], told["count"]


def test_strokes_and_steps_are_kept_and_taken_back_the_steps_first(folder):
    assert change(folder, "stroke", STROKE) == (1, 0, 3)
    assert change(folder, "grow", 1) == (1, 1, 4)
    assert change(folder, "stroke", STROKE) == (2, 1, 7)
    assert change(folder, "grow", -1) == (2, 0, 6)
    assert change(folder, "grow", -1) == change(folder, "look") == (2, -1, 5)
    assert change(folder, "undo") == (2, 0, 6)
    assert change(folder, "undo") == (1, 0, 3)
    for sign in (1, -1):
        for _ in range(2 * MOST_GROWN + 1):
            strokes, grown, _ = change(folder, "grow", sign)
        assert (strokes, grown) == (1, sign * MOST_GROWN)
    drawing = Drawing(folder, default_registry())
    assert drawing.is_drawn("jar") and drawing.file("jar").is_file()
    assert change(folder, "clear") == (0, 0, 0)
    assert not drawing.is_drawn("jar")
    with pytest.raises(InputError, match="draw around something"):
        drawing.file("jar")


def test_the_viewer_is_told_a_bit_for_each_gaussian_that_it_holds(folder):
    told = Drawing(folder, default_registry()).change(
        "jar", {"do": "stroke", "value": STROKE}
    )
    bits = np.unpackbits(np.frombuffer(bytes.fromhex(told["bits"]), np.uint8))
    assert bits[:14].tolist() == [1, 1] + [0] * 12, "of 21 a third hardly shows"
    assert not bits[14:].any()


def test_what_cannot_be_drawn_is_refused(folder):
    with pytest.raises(InputError, match="no such change"):
        change(folder, "burn")
    with pytest.raises(InputError, match="no scene to draw on"):
        change(folder, "stroke", STROKE, run="empty")
