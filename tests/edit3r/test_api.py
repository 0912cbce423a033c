"""`edit3r.run` can do what the command line can."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.reporting import Report
from edit3r.contract.types import Cameras
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.photos.images import save_image

pytestmark = pytest.mark.slow

QUICK = {"gaussians": "all", "refine": 0, "frames": 2, "size": 96}


@pytest.fixture(scope="module")
def posed(tmp_path_factory):
    """Two photos of a generated scene as files, their cameras, and a mask of the left half."""
    folder = tmp_path_factory.mktemp("posed")
    sample = edit3r.build(
        "dataset", "procedural", image_size=96, scenes=1, seed=3, textures=8
    )[0]
    names = [f"{index}.png" for index in range(len(sample.context))]
    for name, image in zip(names, sample.context):
        save_image(image, folder / name)
        mask = torch.zeros_like(image)
        mask[:, :, : image.shape[-1] // 2] = 1
        save_image(mask, folder / f"mask_{name}")
    write_cameras(folder / "cameras.json", posed_cameras(sample.context_cameras, names))
    return folder, sample


def run(posed, **asked):
    folder, _ = posed
    photos = [folder / "0.png", folder / "1.png"]
    return edit3r.run(photos, "make it red", editor="recolor", **QUICK, **asked)


def test_a_masked_edit_with_given_cameras_is_edited_again(posed, tmp_path):
    folder, sample = posed
    masks = [folder / "mask_0.png", folder / "mask_1.png"]
    first = run(posed, masks=masks, cameras=folder / "cameras.json")
    true = (
        torch.linalg.inv(sample.context_cameras.c2w[0, 0])
        @ sample.context_cameras.c2w[0, 1]
    )
    assert torch.allclose(first.cameras.c2w[0, 1], true, atol=1e-5)
    outside = first.masks[0] == 0
    photos, edited = first.photos.images[0], first.edited.images[0]
    assert torch.equal(photos.movedim(1, -1)[outside], edited.movedim(1, -1)[outside])

    marks = edit3r.Selection(masks={0: 1 - first.masks[0, 0], 1: 1 - first.masks[0, 1]})
    second = edit3r.run(prompt="make it blue", earlier=first, masks=marks, **QUICK)
    assert second.records.inputs.prompts == ("make it red", "make it blue")
    assert torch.equal(second.cameras.c2w, first.cameras.c2w)
    assert torch.equal(second.photos.images, first.photos.images)
    kept = second.edited.images[0].movedim(1, -1)[~outside]
    assert torch.equal(kept, edited.movedim(1, -1)[~outside])
    assert second.reconstructor is first.reconstructor

    third = edit3r.run(
        prompt="make it darker", earlier=second.save(tmp_path / "second"), **QUICK
    )
    assert (
        third.records.inputs.prompts[-1] == "make it darker"
        and len(third.records.inputs.prompts) == 3
    )


def test_mask_files_and_a_preset_stand_in_the_manifest(posed, tmp_path):
    folder, _ = posed
    mask = str(folder / "mask_0.png")
    result = edit3r.run(
        [folder / "0.png", folder / "1.png"],
        "make it red",
        masks=mask,
        quality="fast",
        outputs=(),
        **{**QUICK, "size": 64},
    )
    manifest = json.loads((result.save(tmp_path / "out") / "run.json").read_text())
    assert list(manifest["masks"]) == [mask]
    assert manifest["notes"]["quality"]["preset"] == "fast"


def test_cameras_of_loaded_views_are_used(posed):
    folder, sample = posed
    views = edit3r.load_views([folder / "0.png", folder / "1.png"])
    cameras = sample.context_cameras
    moved = Cameras(cameras.c2w, cameras.intrinsics, views.image_size)
    result = edit3r.run(views, editor="none", cameras=moved, **QUICK)
    assert torch.allclose(
        result.cameras.c2w[0, 1, :3, 3].norm(),
        (cameras.c2w[0, 1, :3, 3] - cameras.c2w[0, 0, :3, 3]).norm(),
        atol=1e-5,
    )


@pytest.fixture(scope="module")
def result(posed):
    return run(posed, masks=edit3r.Selection(positive=((0, 0.5, 0.5),)))


def with_rendered(result, rendered):
    records = result.records
    judged = replace(records.judged, rendered=rendered)
    return replace(result, records=replace(records, judged=judged))


def test_two_results_are_compared_on_one_sheet(result):
    red, green = torch.eye(3)[:2, :, None, None]
    shown = result.rendered.images
    first, second = (
        with_rendered(result, replace(result.rendered, images=colour + 0 * shown))
        for colour in (red, green)
    )
    pixels = np.asarray(first.compare(second))
    shares = [
        (pixels == colour).all(-1).mean() for colour in ([255, 0, 0], [0, 255, 0])
    ]
    assert shares[0] == shares[1] > 0.12


@pytest.mark.parametrize(
    "more, same",
    [({}, True), ({"quality": "fast"}, False), ({"recon": "edit3r"}, False)],
)
def test_a_further_edit_has_the_reconstructor_unless_another_or_a_quality_is_asked_for(
    result, monkeypatch, more, same
):
    jobs = []
    monkeypatch.setattr("edit3r.api.run_job", lambda job, *rest: jobs.append(job))
    edit3r.run(prompt="make it blue", earlier=result, report=Report(), **more)
    (job,) = jobs
    assert (job.components.get("reconstructor") is result.reconstructor) == same


def test_photos_that_are_given_are_edited_from_the_start(posed, result, monkeypatch):
    jobs = []
    monkeypatch.setattr("edit3r.api.run_job", lambda job, *rest: jobs.append(job))
    for photos in ((), [posed[0] / "0.png", posed[0] / "1.png"]):
        edit3r.run(photos, "make it blue", earlier=result, report=Report())
    again, anew = jobs
    assert again.earlier is not None and anew.earlier is None
    assert again.config.frames == anew.config.frames == QUICK["frames"]


def test_results_of_different_photos_are_not_compared(result):
    photos = replace(result.photos, names=("x", "y"))
    with pytest.raises(InputError, match="different photos: 0, 1, and x, y"):
        inputs = replace(result.records.inputs, photos=photos)
        result.compare(replace(result, records=replace(result.records, inputs=inputs)))


def test_progress_is_shown_where_it_is_asked_for(posed, tmp_path, capsys):
    save_image(torch.zeros(3, 96, 96), tmp_path / "black.png")
    masks = [posed[0] / "mask_0.png", tmp_path / "black.png"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # they are shown, and not raised as well
        run(posed, masks=masks, progress=True)
    shown = capsys.readouterr().err
    assert "reconstruct" in shown and "warning: " in shown and "all black" in shown
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run(posed, masks=masks)
    assert not capsys.readouterr().err


def test_marks_in_words_need_files(posed):
    folder, _ = posed
    views = edit3r.load_views([folder / "0.png", folder / "1.png"])
    with pytest.raises(InputError, match="photos that were read from files"):
        edit3r.run(views, "make it red", masks=folder / "mask_0.png", **QUICK)


def test_a_second_name_for_the_reconstructor_is_refused_and_not_forgotten():
    with pytest.raises(SettingsError, match="recon="):
        edit3r.run(reconstructor="classical")
