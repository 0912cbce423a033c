"""Words to masks to edits, by the command a user types, on tiny random weights."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from edit3r.cli.main import main

FLAT = Path(__file__).parents[1] / "flat_scene.py"
PARTS = "--recon flat --rasterizer torch --fov 60 --frames 2 --refine 0 --quiet"
CHEAP = [f"--plugin={FLAT}", *PARTS.split()]


@pytest.fixture
def photos(tmp_path, photo) -> list[str]:
    pixels = (photo * 255).round().byte().permute(1, 2, 0).numpy()
    for name, picture in (("a", pixels), ("b", np.roll(pixels, 2, axis=1))):
        Image.fromarray(picture).save(tmp_path / f"{name}.png")
    return [str(tmp_path / "a.png"), str(tmp_path / "b.png")]


@pytest.fixture
def sam2(sam2_folder, dino_folder) -> list[str]:
    settings = {
        "model": sam2_folder,
        "local_files_only": "true",
        "detector.model": dino_folder,
        "detector.box_threshold": 0.0,
        "detector.local_files_only": "true",
    }
    given = [f"--set=segmenter.{name}={value}" for name, value in settings.items()]
    return ["--segmenter", "sam2", *given]


def run(photos, out: Path, *flags: str) -> dict:
    assert main(["run", *photos, *CHEAP, "--out", str(out), *flags]) == 0
    return json.loads((out / "run.json").read_text())


def found_in(manifest: dict, key: str):
    """The value of a note wherever the manifest keeps it."""
    if key in manifest:
        return manifest[key]
    inside = (
        found_in(value, key) for value in manifest.values() if isinstance(value, dict)
    )
    return next((value for value in inside if value is not None), None)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["--prompt", "paint the bike red"],  # by the default editor
        ["--editor", "mock-diffusion", "--prompt", "make it winter", "--thing", "door"],
    ],
)
def test_an_edit_is_confined_to_words_where_a_segmenter_is_named(
    photos, sam2, tmp_path, words
):
    manifest = run(photos, tmp_path / "out", *words, *sam2, "--guess")
    assert found_in(manifest, "selection")["how"][0] == "words"


def test_words_that_nothing_matches_end_the_run(photos, sam2, tmp_path, capsys):
    out = tmp_path / "out"
    nothing = "--set segmenter.detector.box_threshold=1.0 --editor mock-diffusion"
    command = ["run", *photos, *CHEAP, *sam2, *nothing.split(), "--out", str(out)]
    assert main([*command, "--prompt", "paint the bike red"]) == 3
    assert "what is meant by 'bike'?" in capsys.readouterr().err and not out.exists()
