"""`edit3r uncertainty` on a run: what it says, writes, refuses, and never touches."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from edit3r.cli.main import main
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import load_ply, save_ply
from edit3r_testing import CommandContract

FLAT = Path(__file__).parents[1] / "flat_scene.py"


class TestUncertainty(CommandContract):
    component = "uncertainty"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a run, and the run with its uncertainty."""
    place = tmp_path_factory.mktemp("uncertainty")
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(place / f"{name}.png")
    settings = "editor=none reconstructor=flat refine=0 gaussians=all size=48"
    given = [f"--set={one}" for one in f"{settings} outputs=scene,images".split()]
    photos = [str(place / "a.png"), str(place / "b.png")]
    plugin = ["--plugin", str(FLAT), "--quiet", "--out", str(place / "run")]
    assert main(["run", *photos, *given, *plugin]) == 0
    line = f"uncertainty {place}/run --out {place}/sure --maps --quiet"
    assert main(line.split()) == 0
    return place


def test_the_new_folder_is_the_run_with_numbers_and_maps(made):
    before, after = ((made / name / "scene.ply") for name in ("run", "sure"))
    scene = load_ply(after)
    assert 0 <= scene.uncertainty.min() < scene.uncertainty.max() <= 1
    save_ply(made / "plain.ply", replace(scene, uncertainty=None))
    body = [
        path.read_bytes().partition(b"end_header\n")[2]
        for path in (before, made / "plain.ply")
    ]
    assert body[0] == body[1]
    assert b"uncertainty" not in before.read_bytes()
    assert (made / "sure" / "uncertainty.png").is_file()
    page = (made / "sure" / "viewer.html").read_text("utf-8")
    assert '"second": "uncertainty"' in page and '"unsure": true' in page
    maps = {path.name for path in (made / "sure" / "uncertainty").iterdir()}
    assert maps == {"a.png", "b.png", "between_0_1.png"}
    facts = json.loads((made / "sure" / "run.json").read_text())
    assert 0 < facts["uncertainty"]["mean"] < 1
    assert facts["inputs"]


def test_it_says_what_rests_on_one_photo(made, capsys):
    line = f"uncertainty {made}/sure --out {made}/twice"
    assert main(line.split()) == 0
    said = capsys.readouterr().out
    assert "of the scene rests on one photo alone: its depth is a guess" in said
    assert not (made / "twice" / "uncertainty").exists()
    again, first = (load_ply(made / name / "scene.ply") for name in ("twice", "sure"))
    assert (again.uncertainty - first.uncertainty).abs().max() < 1e-3


def without(made, name):
    run = made / f"without_{name.replace('.', '_')}"
    shutil.copytree(made / "run", run)
    path = run / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    return run


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("scene.ply", "no such file"),
        ("inputs", "has no photos"),
        ("edited", "a.png"),
        ("cameras.json", "it lacks cameras.json"),
        ("run.json", "run.json"),
    ],
)
def test_a_bad_folder_is_refused_in_a_sentence(made, missing, said, capsys):
    run = without(made, missing)
    line = f"uncertainty {run} --out {made}/no"
    assert main(line.split()) == 2
    told = capsys.readouterr().err
    assert said in told and "Traceback" not in told
    assert not (made / "no").exists()


def test_cameras_of_other_photos_are_refused(made, capsys):
    run = made / "other_cameras"
    shutil.copytree(made / "run", run)
    cameras = json.loads((run / "cameras.json").read_text())
    (run / "cameras.json").write_text(json.dumps(cameras[:1]))
    assert main(f"uncertainty {run} --out {made}/no".split()) == 2
    assert "has 1 cameras" in capsys.readouterr().err
    assert not (made / "no").exists()


def test_the_run_is_never_overwritten(made, capsys):
    assert main(f"uncertainty {made}/run --out {made}/run".split()) == 2
    assert "would overwrite a file that is read" in capsys.readouterr().err
    assert (made / "run" / "scene.ply").is_file()
