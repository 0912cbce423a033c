"""One run after another: what is computed again, what stays, and what is said when the folder is no good."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from edit3r_refiners.keep_outside_mask import differing
from PIL import Image

from edit3r.cli.main import main
from edit3r.io.images import save_image, to_bytes
from edit3r.pipeline import run
from edit3r.reuse.memory import Memory
from edit3r.reuse.state import FOLDER, load_state

PLUGIN = Path(__file__).parent / "planted.py"
PARTS = ("--recon", "planted", "--editor", "inverted", "--rasterizer", "numba", "--plugin", str(PLUGIN), "--quiet")


@pytest.fixture
def edit(planted, rasterizer):
    """Runs the pipeline on the planted photos."""

    def edited(views=planted.views, **asked):
        chosen = {"editor": "inverted", "recon": "planted", "rasterizer": rasterizer, "registry": planted.registry}
        return run(views, "x", **{**chosen, **asked})

    return edited


def picture(rasterizer, result, gaussians=None):
    return rasterizer.render(result.gaussians if gaussians is None else gaussians, result.cameras).images[0]


def test_with_masks_pixels_outside_render_as_the_unedited_photos_do(planted, rasterizer, edit):
    masks = planted.masks[0]
    plain = planted.reconstruct(planted.views).gaussians
    result = edit(masks=masks)
    outside = masks[0] == 0
    change = (picture(rasterizer, result) - picture(rasterizer, result, plain)).abs().amax(1)
    assert float(change[outside].amax()) <= 1e-6 and float(change.amax()) > 0.2


def test_matching_is_done_once_although_two_reconstructions_are_made(planted, edit):
    edit(masks=planted.masks[0])
    assert sorted(planted.calls) == ["edit", "match", "reconstruct", "reconstruct"]


def test_without_masks_a_first_edit_costs_no_second_reconstruction(planted, edit):
    edit()
    assert sorted(planted.calls) == ["edit", "match", "reconstruct"]


@pytest.fixture
def folders(planted, tmp_path):
    """Photos and masks as files, and a first run of them into `first`."""
    for index, name in enumerate(("a", "b")):
        save_image(planted.views.images[0, index], tmp_path / f"{name}.png")
        for ball in (0, 1):
            mask = Image.fromarray((planted.masks[ball, 0, index] * 255).byte().numpy())
            mask.save(tmp_path / f"ball{ball}_{name}.png")
    photos = [str(tmp_path / f"{name}.png") for name in ("a", "b")]
    first = tmp_path / "first"
    command = ["run", *photos, *PARTS, "--prompt", "A", "--fov", "51.57", "--frames", "3", "--out", str(first)]
    assert main([*command, "--mask", *masks_of(tmp_path, 0)]) == 0
    return tmp_path


def masks_of(folder, ball):
    return [str(folder / f"ball{ball}_{name}.png") for name in ("a", "b")]


def again(folder, *more, start="first", out="second"):
    command = ["run", "--from", str(folder / start), "--editor", "inverted", "--rasterizer", "numba", "--quiet"]
    return main([*command, "--plugin", str(PLUGIN), "--out", str(folder / out), *more])


def test_a_second_edit_computes_only_the_edit_and_one_reconstruction(planted, folders, rasterizer):
    first = len(planted.calls)
    assert first == 4  # edit, match, and the scene without and with the edit
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    assert sorted(planted.calls[first:]) == ["edit", "reconstruct"]
    notes = json.loads((folders / "second" / "run.json").read_text())["notes"]
    assert notes["reuse.reused"] == ["match"] and notes["reuse.edits"] == ["A", "B"]
    assert notes["reuse.computed"] == [] and notes["reuse.frames"] == 3


def test_a_sequence_of_edits_keeps_the_first_and_its_outside(planted, folders, rasterizer):
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    one, two = (load_state(folders / name) for name in ("first", "second"))
    before, after = (rasterizer.render(s.scene.gaussians, s.scene.cameras).images[0] for s in (one, two))
    change = (after - before).abs().amax(1)
    outside = planted.masks[1, 0] == 0
    assert float(change[outside].amax()) <= 1e-6 and float(change[~outside].amax()) > 0.2
    assert torch.equal(two.photos.images, planted.views.images) and two.prompts == ("A", "B")
    assert torch.equal(two.edited.images[0].movedim(1, -1)[outside], one.edited.images[0].movedim(1, -1)[outside])
    assert 0 < int(differing(one.scene.gaussians, two.scene.gaussians).sum()) < one.scene.gaussians.count / 2


def test_given_photos_are_edited_from_the_start_with_what_is_known_of_them(planted, folders):
    first = len(planted.calls)
    photos = [str(folders / f"{name}.png") for name in ("a", "b")]
    more = (*photos, "--fov", "51.57", "--recon", "planted", "--prompt", "B", "--mask", *masks_of(folders, 1))
    assert again(folders, *more) == 0
    assert sorted(planted.calls[first:]) == ["edit", "reconstruct"]
    assert load_state(folders / "second").prompts == ("B",)


def assert_frames_are_taken_up_and_those_drawn_whole(folders, rasterizer):
    assert json.loads((folders / "second" / "run.json").read_text())["notes"]["reuse.frames"] == 3
    one, two = (load_state(folders / name) for name in ("first", "second"))
    assert torch.equal(two.path.c2w, one.path.c2w) and two.drawn.frames != one.drawn.frames
    for index, picture in enumerate(rasterizer.render(two.scene.gaussians, two.path).images[0]):
        file = folders / "second" / "renders" / f"path_{index:04d}.png"
        assert (np.array(Image.open(file)) == to_bytes(picture)).all()


def test_frames_of_a_further_edit_are_those_of_its_scene_drawn_whole(folders, rasterizer):
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    assert_frames_are_taken_up_and_those_drawn_whole(folders, rasterizer)


def test_frames_of_another_edit_of_the_photos_are_those_of_its_scene_drawn_whole(folders, rasterizer):
    for file in masks_of(folders, 0):
        mask = np.array(Image.open(file))
        mask[: len(mask) // 2] = 0
        Image.fromarray(mask).save(file)
    photos = [str(folders / f"{name}.png") for name in ("a", "b")]
    more = (*photos, "--fov", "51.57", "--recon", "planted", "--prompt", "B", "--mask", *masks_of(folders, 0))
    assert again(folders, *more) == 0
    assert_frames_are_taken_up_and_those_drawn_whole(folders, rasterizer)


def test_what_changed_is_computed_again(planted, folders):
    first = len(planted.calls)
    more = ("--prompt", "B", "--set", "reconstructor.matcher.depth=1.1", "--mask", *masks_of(folders, 1))
    assert again(folders, *more) == 0
    assert sorted(planted.calls[first:]) == ["edit", "match", "reconstruct"]


@pytest.mark.parametrize("harm", ["missing", "foreign", "empty", "cut", "tampered", "part"])
def test_a_folder_that_cannot_be_continued_is_one_sentence(folders, capsys, harm):
    folder, state = folders / "first", folders / "first" / FOLDER / "scene.safetensors"
    content = state.read_bytes()
    if harm == "missing":
        shutil.rmtree(folder)
    elif harm == "foreign":
        shutil.rmtree(folder / FOLDER)
    elif harm == "empty":
        state.write_bytes(b"")
    elif harm == "cut":
        state.write_bytes(content[: len(content) // 2])
    elif harm == "tampered":
        state.write_bytes(content[:-40] + bytes(40))
    else:
        next((folder / FOLDER).glob("match-*")).write_bytes(b"nothing")
    assert again(folders, "--prompt", "B") == 2
    said = capsys.readouterr().err.strip()
    assert "first" in said and len(said.splitlines()) == 1 and not (folders / "second").exists()


def test_the_state_comes_back_as_it_was(folders):
    state = load_state(folders / "first")
    assert state.photos.names == ("a", "b") and [record.name for record in state.records] == ["a", "b"]
    assert state.records[0].frame.target == (48, 64) and state.path.count == 3
    assert Memory(folders / "first" / FOLDER).reused == []
