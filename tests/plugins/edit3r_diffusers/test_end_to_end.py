"""The command a user types, on tiny random weights and two photos."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from edit3r.cli.main import main

FLAT = str(Path(__file__).parents[1] / "flat_scene.py")
CHEAP = ["--prompt", "paint it red", "--plugin", FLAT, "--recon", "flat"]
CHEAP += ["--rasterizer", "torch", "--frames", "2", "--fov", "60"]
CHEAP += ["--refine", "0", "--outputs", "images"]
SIDE = 32


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("photos")
    y, x = np.mgrid[0:SIDE, 0:SIDE] * 255 // SIDE
    for name, channels in (("a", (x, y, x)), ("b", (y, x, 255 - y))):
        Image.fromarray(np.stack(channels, -1).astype(np.uint8)).save(
            folder / f"{name}.png"
        )
    mask = np.zeros((SIDE, SIDE), np.uint8)
    mask[:, : SIDE // 2] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    return [str(folder / name) for name in ("a.png", "b.png", "mask.png")]


@pytest.fixture
def choices(tiny):
    """The flags that name each editor's weights."""
    return {
        "instruct-pix2pix": [f"editor.model={tiny.instruct_pix2pix()}"],
        "controlnet-depth": [
            f"editor.model={tiny.stable_diffusion()}",
            f"editor.controlnet={tiny.controlnet()}",
            "editor.matcher=flat",
        ],
    }


def run(
    photos, out: Path, editor: str, settings: list[str], *flags: str
) -> tuple[np.ndarray, dict]:
    """Edited pictures of one run, and its manifest."""
    quick = "editor.steps=2", "editor.resolution=64", "editor.local_files_only=true"
    chosen = [word for setting in (*settings, *quick) for word in ("--set", setting)]
    asked = f"--editor {editor} --out {out} --quiet".split()
    assert main(["run", *photos[:2], *CHEAP, *chosen, *asked, *flags]) == 0
    edited = [np.array(Image.open(file)) for file in sorted((out / "edited").iterdir())]
    return np.stack(edited), json.loads((out / "run.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("editor", ["instruct-pix2pix", "controlnet-depth"])
def test_a_masked_edit_of_two_views_runs_end_to_end(photos, choices, tmp_path, editor):
    """One of each kind; that every editor obeys prompt, seed and masks is in its contract."""
    mask = photos[2]
    edited, manifest = run(
        photos, tmp_path, editor, choices[editor], "--mask", mask, mask
    )
    assert "editor.weights" in json.dumps(manifest)
    originals = np.stack([np.array(Image.open(file)) for file in photos[:2]])
    half = SIDE // 2
    assert np.array_equal(edited[:, :, half:], originals[:, :, half:])
    assert not np.array_equal(edited[:, :, :half], originals[:, :, :half])


def test_weights_that_are_not_there_end_with_exit_code_2_and_one_sentence(
    photos, tmp_path, capsys
):
    missing = f"--set editor.model={tmp_path}/nothing --out {tmp_path}/out"
    flags = f"--editor instruct-pix2pix {missing}".split()
    code = main(["run", *photos[:2], *CHEAP, *flags])
    said = capsys.readouterr().err
    assert code == 2 and "editor.model: no folder" in said and "Traceback" not in said
