"""One run after another: what is computed again, what stays, and what is said when the folder is no
good.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import edit3r
from edit3r.cli.main import main
from edit3r.kit.cache import Cache
from edit3r.kit.photos.images import save_image
from edit3r.running.run_folder import RunFolder

PLUGIN = Path(__file__).parent / "planted.py"
PARTS = (
    "--recon",
    "planted",
    "--matcher",
    "planted",
    "--editor",
    "inverted",
    "--rasterizer",
    "numba",
    "--plugin",
    str(PLUGIN),
    "--quiet",
)
PLAIN = ("--gaussians", "all", "--refine", "0")  # the Gaussians of the pixels


@pytest.fixture
def edit(planted, rasterizer):
    """Runs the pipeline on the planted photos."""

    def edited(views=planted.views, **asked):
        chosen = {
            "editor": "inverted",
            "recon": "planted",
            "matcher": "planted",
            "rasterizer": rasterizer,
            "registry": planted.registry,
            "prompt": "x",
        }
        return edit3r.run(views, **{**chosen, **asked})

    return edited


def render(rasterizer, gaussians, cameras):
    return rasterizer.render(gaussians, cameras).images[0]


def test_with_masks_pixels_outside_render_as_the_unedited_photos_do(
    planted, rasterizer, edit
):
    masks = planted.masks[0]
    plain = edit(masks=masks, editor="none", gaussians="all", refine=0).gaussians
    result = edit(masks=masks, gaussians="all", refine=0)
    outside = masks[0] == 0
    change = render(rasterizer, result.gaussians, result.cameras) - render(
        rasterizer, plain, result.cameras
    )
    change = change.abs().amax(1)
    assert float(change[outside].amax()) <= 1e-6 and float(change.amax()) > 0.2


def test_matching_is_done_once_although_two_reconstructions_are_made(planted, edit):
    edit(masks=planted.masks[0])
    assert sorted(planted.calls) == ["edit", "match", "reconstruct", "reconstruct"]


def test_without_masks_a_first_edit_costs_no_second_reconstruction(planted, edit):
    edit()
    assert sorted(planted.calls) == ["edit", "match", "reconstruct"]


def test_a_program_that_stays_open_matches_the_same_photos_once(planted, edit):
    cache = Cache()
    first = edit(masks=planted.masks[0], cache=cache)
    planted.calls.clear()
    second = edit(masks=planted.masks[1], cache=cache)
    # of the edited photos; the scene before is known too
    assert sorted(planted.calls) == [
        "edit",
        "reconstruct",
    ]
    assert torch.equal(first.cameras.c2w, second.cameras.c2w)


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
    command = [
        "run",
        *photos,
        *PARTS,
        *PLAIN,
        "--prompt",
        "A",
        "--fov",
        "51.57",
        "--frames",
        "3",
        "--out",
        str(first),
    ]
    assert main([*command, "--mask", *masks_of(tmp_path, 0)]) == 0
    return tmp_path


def masks_of(folder, ball):
    return [str(folder / f"ball{ball}_{name}.png") for name in ("a", "b")]


def again(folder, *more, start="first", out="second"):
    command = [
        "run",
        "--from",
        str(folder / start),
        "--editor",
        "inverted",
        "--rasterizer",
        "numba",
        "--quiet",
    ]
    return main(
        [*command, "--plugin", str(PLUGIN), *PLAIN, "--out", str(folder / out), *more]
    )


def test_a_second_edit_computes_only_the_edit_and_one_reconstruction(planted, folders):
    first = len(planted.calls)
    assert first == 4  # edit, match, and the scene without and with the edit
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    assert sorted(planted.calls[first:]) == ["edit", "reconstruct"]
    notes = json.loads((folders / "second" / "run.json").read_text())["notes"]
    assert (
        set(notes["cache.reused"]) == {"match"}
        and notes["cache.computed"] == []
        and notes["edits"] == ["A", "B"]
    )


def test_a_second_edit_says_of_the_lens_what_the_first_said(folders, capsys):
    manifest = folders / "first" / "run.json"
    content = json.loads(manifest.read_text())
    lens = ["read from the photos: 51.6 degrees across the longer side"]
    content["notes"]["lens.source"] = lens
    content["notes"]["views"]["assumed"] = [True, True]
    manifest.write_text(json.dumps(content))
    capsys.readouterr()
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    notes = json.loads((folders / "second" / "run.json").read_text())["notes"]
    assert notes["lens.source"] == lens


def test_a_sequence_of_edits_keeps_the_first_and_its_outside(
    planted, folders, rasterizer
):
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    one, two = (RunFolder(folders / name).read().inputs for name in ("first", "second"))
    before, after = (
        render(rasterizer, run.before.gaussians, run.before.cameras)
        for run in (one, two)
    )
    change = (after - before).abs().amax(1)
    outside = planted.masks[1, 0] == 0
    assert (
        float(change[outside].amax()) <= 1e-6 and float(change[~outside].amax()) > 0.2
    )
    assert torch.equal(two.photos.images, planted.views.images) and two.prompts == (
        "A",
        "B",
    )
    assert torch.equal(
        two.start.images[0].movedim(1, -1)[outside],
        one.start.images[0].movedim(1, -1)[outside],
    )


def test_gaussians_outside_the_mask_keep_their_bytes_in_the_file(folders, planted):
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    one, two = (
        (folders / name / "scene.ply").read_bytes() for name in ("first", "second")
    )
    one, two = (content.split(b"end_header\n", 1)[1] for content in (one, two))
    rows = [
        np.frombuffer(content, np.uint8).reshape(
            planted.views.images[0, :, 0].numel(), -1
        )
        for content in (one, two)
    ]
    same = (rows[0] == rows[1]).all(1)
    inside = planted.masks[1, 0].flatten().numpy() > 0
    assert same[~inside].all() and not same[inside].all()


def test_undo_is_the_run_before(folders):
    assert again(folders, "--prompt", "B", "--mask", *masks_of(folders, 1)) == 0
    assert again(folders, "--prompt", "", "--editor", "none", out="undone") == 0
    one, undone = (
        (folders / name / "scene.ply").read_bytes() for name in ("first", "undone")
    )
    assert one.split(b"end_header\n", 1)[1] == undone.split(b"end_header\n", 1)[1]


@pytest.mark.slow
def test_a_sentence_that_begins_with_undo_goes_on_from_the_photos(folders, capsys):
    ball = ("--mask", *masks_of(folders, 1))
    more = ("--editor", "recolor", "--prompt")
    assert again(folders, *more, "undo that and paint it red", *ball) == 0
    second = json.loads((folders / "second" / "run.json").read_text())
    assert second["notes"]["edits"] == ["paint it red"]
    assert again(folders, *more, "paint it blue", *ball, start="second", out="3rd") == 0
    assert again(folders, *more, "undo", start="3rd", out="4th") == 2
    assert "edit 2 of 2" in capsys.readouterr().err


def test_without_masks_a_further_edit_changes_what_it_changed_on_the_photos(
    planted, folders
):
    assert again(folders, "--prompt", "B") == 0
    one, two = (RunFolder(folders / name).read().inputs for name in ("first", "second"))
    assert torch.allclose(two.start.images, 1 - one.start.images, atol=1 / 255)
    assert two.before.gaussians.count == one.before.gaussians.count


def test_given_photos_are_edited_from_the_start_with_what_is_known_of_them(
    planted, folders
):
    first = len(planted.calls)
    photos = [str(folders / f"{name}.png") for name in ("a", "b")]
    more = (
        *photos,
        "--fov",
        "51.57",
        "--recon",
        "planted",
        "--matcher",
        "planted",
        "--prompt",
        "B",
        "--mask",
        *masks_of(folders, 1),
    )
    assert again(folders, *more) == 0
    assert sorted(planted.calls[first:]) == ["edit", "reconstruct"]
    assert RunFolder(folders / "second").read().inputs.prompts == ("B",)


def test_what_changed_is_computed_again(planted, folders):
    first = len(planted.calls)
    more = (
        "--prompt",
        "B",
        "--set",
        "matcher.depth=1.1",
        "--mask",
        *masks_of(folders, 1),
    )
    assert again(folders, *more) == 0
    assert sorted(planted.calls[first:]) == ["edit", "match", "reconstruct"]


@pytest.mark.parametrize(
    "harm",
    [
        "missing",
        "foreign",
        "no list",
        "cut scene",
        "no image",
        "other size",
    ],
)
def test_a_folder_that_cannot_be_continued_is_one_sentence(folders, capsys, harm):
    folder = folders / "first"
    if harm == "missing":
        shutil.rmtree(folder)
    elif harm == "foreign":
        (folder / "run.json").unlink()
    elif harm == "no list":
        (folder / "run.json").write_text("{}")
    elif harm == "cut scene":
        (folder / "scene.ply").write_bytes((folder / "scene.ply").read_bytes()[:2000])
    elif harm == "no image":
        (folder / "edited" / "a.png").unlink()
    else:
        save_image(torch.zeros(3, 5, 5), folder / "edited" / "a.png")
    assert again(folders, "--prompt", "B") == 2
    said = capsys.readouterr().err.strip()
    assert (
        "first" in said
        and len(said.splitlines()) == 1
        and not (folders / "second").exists()
    )


def test_a_damaged_answer_is_computed_anew(folders, planted, capsys):
    next((folders / "first" / "cache").glob("match-*")).write_bytes(b"nothing")
    first = len(planted.calls)
    assert again(folders, "--prompt", "B") == 0
    assert "match" in planted.calls[first:]
    assert "its content is computed again" in json.dumps(
        json.loads((folders / "second" / "run.json").read_text())
    )


@pytest.mark.parametrize(
    "name", ["../../evil", "/tmp/evil", "..", "", "a\0b", "x" * 300, 7]
)
def test_a_view_name_in_a_strangers_folder_never_becomes_a_path(folders, capsys, name):
    file = folders / "first" / "run.json"
    manifest = json.loads(file.read_text())
    manifest["notes"]["views"]["names"][0] = name
    file.write_text(json.dumps(manifest))
    assert again(folders, "--prompt", "B") == 2
    assert (
        "is no plain file name" in capsys.readouterr().err
        and not (folders / "second").exists()
    )


def test_the_earlier_run_comes_back_as_it_was(folders, planted):
    read = RunFolder(folders / "first").read()
    earlier = read.inputs
    assert earlier.photos.names == ("a", "b") and [
        record.name for record in earlier.files
    ] == ["a", "b"]
    assert earlier.files[0].frame.target == (48, 64) and read.settings["frames"] == 3
    assert torch.equal(earlier.photos.images, planted.views.images)


def test_masks_of_what_was_named_are_known_to_the_next_run(folders, capsys):
    files = [str(folders / f"ball0_{name}.png") for name in ("a", "b")]
    fox = ("--editor", "recolor", "--prompt", "paint the fox red")
    assert again(folders, *fox, "--mask", *files) == 0
    second = RunFolder(folders / "second").read().inputs
    expected = np.stack([np.array(Image.open(file)) for file in files]) / 255
    assert np.allclose(second.things["fox"], expected, atol=1e-3)
    third = {"start": "second", "out": "third"}
    assert again(folders, *fox, "--prompt", "paint the fox blue", **third) == 0
    assert "fox" in RunFolder(folders / "third").read().inputs.things
    (folders / "second" / "masks" / "0" / "b.png").write_bytes(b"no image")
    assert again(folders, *fox, start="second", out="fourth") == 2
    assert "b.png" in capsys.readouterr().err and not (folders / "fourth").exists()
