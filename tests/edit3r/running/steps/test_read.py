"""Masks that a camera file names are taken where nothing else is marked."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.photos.coverage import USUAL_FRAMES
from edit3r.kit.photos.images import find_photos
from edit3r.running.config import JobInputs
from edit3r.running.job import job_from
from edit3r.running.steps.read import read

NAMES = ("a.png", "b.png")


@pytest.fixture
def scene(tmp_path):
    """Reads two photos whose transforms.json names masks with so much white."""
    noise = np.random.default_rng(0).integers(0, 255, (30, 40, 3), dtype=np.uint8)

    def of(white, *, masks=NAMES, prompt="paint it red", settings=None, **marks):
        mask = np.zeros((30, 40), np.uint8)
        mask[:, : round(40 * white)] = 255
        (tmp_path / "masks").mkdir(exist_ok=True)
        frames = []
        for name in NAMES:
            Image.fromarray(noise).save(tmp_path / name)
            frames.append({"file_path": name, "fl_x": 50, "w": 40, "h": 30})
        for name, frame in zip(masks, frames):
            if name in NAMES:
                Image.fromarray(mask).save(tmp_path / "masks" / name)
            frame["mask_path"] = f"masks/{name}"
        (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
        inputs = JobInputs(
            photos=tuple(str(tmp_path / name) for name in NAMES), **marks
        )
        config = {"prompt": prompt, **(settings or {})}
        job = replace(job_from(inputs, config), components={"reader": None})
        with collecting(Report()) as report:
            return read(job, None, None), report

    return of


def test_masks_of_a_thing_are_what_may_change(scene):
    found, report = scene(0.25)
    assert [round(float(m.mean()), 2) for m in found.marked.masks.values()] == [
        0.25
    ] * 2
    assert len(found.mask_files) == 2 and "25%" in report.notes["selection.masks"]
    assert list(scene(0.25, masks=NAMES[:1])[0].marked.masks) == [0]


def test_masks_that_leave_out_what_moves_are_not_used(scene):
    found, report = scene(0.9)
    assert found.marked is None and "90%" in report.notes["selection.masks"]


def test_own_marks_come_first_and_without_a_sentence_there_are_none(scene):
    assert not scene(0.25, point=("0.5,0.5",))[0].marked.masks
    assert scene(0.25, prompt="")[0].marked is None


def test_masks_that_cannot_be_read_are_warned_of(scene):
    found, report = scene(0.25, masks=("a.png", "b.nothing"))
    assert found.marked is None and "not used" in str(report.warnings)


@pytest.mark.parametrize("views, most", [(2, USUAL_FRAMES), (50, 50)])
def test_a_video_gives_as_many_frames_as_views_are_asked_for(
    scene, monkeypatch, views, most
):
    asked = []
    monkeypatch.setattr(
        "edit3r.running.steps.read.find_photos",
        lambda paths, frames: asked.append(frames) or find_photos(paths, frames),
    )
    scene(0.5, settings={"views": views})
    assert asked == [most]


def test_the_folder_of_a_run_is_no_photo_and_both_ways_on_are_named(tmp_path):
    (tmp_path / "run.json").write_text("{}")
    Image.new("RGB", (40, 30)).save(tmp_path / "before_after.png")
    job = job_from(JobInputs(photos=(str(tmp_path),)), {"prompt": "paint it red"})
    with pytest.raises(InputError, match=r"--from .*, or edit its scene: .*scene.ply"):
        read(replace(job, components={"reader": None}), None, None)
    # photos beside a run are read
    Image.new("RGB", (40, 30)).save(tmp_path / "photo.png")
    assert read(replace(job, components={"reader": None}), None, None).photos.count == 2
