"""The command a user types, against the fake service."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from edit3r.cli.main import main

FLAT = Path(__file__).parents[1] / "flat_scene.py"
PARTS = "--recon flat --rasterizer torch --fov 60 --frames 2 --refine 0 --quiet"
CHEAP = [f"--plugin={FLAT}", *PARTS.split()]
SECRET = "sk-very-secret"


def write_photos(folder: Path) -> list[str]:
    y, x = np.mgrid[40:200:24j, 40:200:32j]
    for name, channels in (("a", (x, y, x)), ("b", (y, x, y))):
        Image.fromarray(np.stack(channels, -1).astype(np.uint8)).save(
            folder / f"{name}.png"
        )
    mask = np.zeros((24, 32), np.uint8)
    mask[:, :16] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    return [str(folder / name) for name in ("a.png", "b.png", "mask.png")]


def run(photos, fake, editor: str, out: Path, *flags: str) -> int:
    base = f"{fake.url}/v1" if editor == "gpt-image" else fake.url
    settings = [
        f"editor.base_url={base}",
        f"editor.cache={out.parent / 'cache'}",
        "editor.attempts=1",
    ]
    chosen = [word for setting in settings for word in ("--set", setting)]
    command = [
        "run",
        *photos[:2],
        "--prompt",
        "paint it red",
        "--editor",
        editor,
        *CHEAP,
        *chosen,
        "--out",
        str(out),
    ]
    return main([*command, *flags])


@pytest.mark.slow
def test_a_two_view_edit_runs_masked_and_its_bill_is_in_the_manifest(
    fake, editor_name, tmp_path
):
    photos = write_photos(tmp_path)
    assert (
        run(photos, fake, editor_name, tmp_path / "out", "--mask", photos[2], photos[2])
        == 0
    )
    originals = np.stack([np.array(Image.open(file)) for file in photos[:2]])
    edited = np.stack(
        [
            np.array(Image.open(file))
            for file in sorted((tmp_path / "out" / "edited").iterdir())
        ]
    )
    assert np.array_equal(edited[:, :, 16:], originals[:, :, 16:])
    assert (
        np.abs(edited[:, :, :14].astype(int) - (255 - originals[:, :, :14])).max() < 12
    )
    manifest = (tmp_path / "out" / "run.json").read_text()
    assert (
        '"cost_usd"' in manifest
        and '"from_cache"' in manifest
        and SECRET not in manifest
    )
    assert json.loads(manifest)["seed"] == 0


@pytest.mark.slow
def test_a_run_that_broke_goes_on_without_paying_for_the_first_view_again(
    fake, editor_name, tmp_path, capsys
):
    photos = write_photos(tmp_path)
    fake.script.extend(["ok", "refusal"])
    assert (
        run(photos, fake, editor_name, tmp_path / "out", "--set", "editor.concurrent=1")
        == 2
    )
    said = capsys.readouterr().err
    assert (
        "I will not paint that." in said
        and "will not be charged again" in said
        and SECRET not in said
    )
    assert not (tmp_path / "out").exists()
    assert run(photos, fake, editor_name, tmp_path / "out") == 0
    assert len(fake.requests) == 3
