"""Marks in a file, and masks from them."""

import io
from pathlib import Path

import pytest
import torch
from edit3r_app import uploads
from edit3r_app.choosing import Chooser, Draft, Stroke, read_draft, write_draft
from edit3r_app.jobs import JobsFolder
from PIL import Image

from edit3r.errors import InputError
from edit3r.io.images import packaged_pair
from edit3r.reporting import Report, collecting


@pytest.fixture
def folder(tmp_path):
    return JobsFolder(tmp_path)


@pytest.fixture
def scene(folder):
    return uploads.copied(
        folder, "motorcycle", [Path(file) for file in packaged_pair()[0]]
    )


def test_a_draft_survives_a_restart(folder, scene):
    strokes = [Stroke(1, False, 0.04, [(0.2, 0.3), (0.4, 0.3)])]
    draft = Draft(
        [(0, 0.5, 0.5)],
        [(1, 0.1, 0.2)],
        {1: (0.1, 0.1, 0.3, 0.3)},
        strokes,
        "sky",
        True,
        {"prompt": "gold"},
    )
    write_draft(folder, scene, draft)
    assert read_draft(JobsFolder(folder.root), scene) == draft


@pytest.mark.parametrize(
    "content",
    [
        *("", "[]", '{"positive": [[0, "x", 1]]}', '{"boxes": {"a": 1}}'),
        '{"strokes": [{"view": 0, "add": true, "radius": 0.1, "places": []}]}',
        '{"strokes": [{"view": 0, "add": true, "radius": 0.1, "places": [[NaN, 0.5]]}]}',
    ],
)
def test_a_damaged_draft_is_an_empty_one(folder, scene, content):
    (folder.beside(scene) / "draft.json").write_text(content)
    assert read_draft(folder, scene) == Draft()


def test_more_clicks_than_anybody_makes_are_refused(folder, scene):
    with pytest.raises(InputError, match="200 clicks"):
        write_draft(folder, scene, Draft([(0, 0.5, 0.5)] * 201))


def test_a_click_gives_a_mask_on_every_photo_and_files_for_the_run(folder, scene):
    chooser, draft = Chooser(folder, size=96), Draft([(0, 0.5, 0.5)])
    assert (
        chooser.masks(scene, Draft()) is None
        and chooser.save_masks(scene, Draft(), "job") == 0
    )
    found = chooser.masks(scene, draft)
    assert (
        found.masks.shape == (2, 1, *chooser.views(scene).image_size)
        and (found.masks[0] > 0.5).any()
    )
    assert chooser.masks(scene, draft) is found  # asked for again by every picture
    assert chooser.save_masks(scene, draft, "job") == 2
    saved = Image.open(folder.beside("job") / "000.png").convert("L")
    assert (
        saved.size == chooser.views(scene).image_size[::-1]
        and saved.getextrema()[1] > 127
    )
    plain, marked = (
        Image.open(io.BytesIO(chooser.picture(scene, one, 0)))
        for one in (Draft(), draft)
    )
    assert plain.size == marked.size and plain.tobytes() != marked.tobytes()


def test_the_brush_paints_exactly_and_the_eraser_takes_away(folder, scene):
    chooser = Chooser(folder, size=96)
    across = [(0.2, 0.5), (0.8, 0.5)]
    painted = chooser.masks(scene, Draft(strokes=[Stroke(0, True, 0.05, across)]))
    height, width = chooser.views(scene).image_size
    rows = (painted.masks[0, 0, :, width // 2] > 0.5).nonzero()[:, 0] + 0.5
    assert (rows - height / 2).abs().max() < 0.05 * max(
        height, width
    ) + 1.5  # nothing but the stroke
    assert len(rows) >= 2 * 0.05 * max(height, width) - 2
    assert (painted.masks[1] > 0.5).any()  # carried
    erased = chooser.masks(
        scene,
        Draft(
            strokes=[
                Stroke(0, True, 0.05, across),
                Stroke(0, False, 0.1, [(0.5, 0.5), (0.5, 0.5)]),
            ]
        ),
    )
    lost = (painted.masks[0] > 0.5) & (erased.masks[0] <= 0.5)
    assert lost[0, height // 2, width // 2] and not lost[0, height // 2, width // 4]


def test_more_strokes_than_are_kept_are_refused(folder, scene):
    with pytest.raises(InputError, match="larger brush"):
        write_draft(
            folder, scene, Draft(strokes=[Stroke(0, True, 0.05, [(0.5, 0.5)] * 4001)])
        )


def test_geometry_is_read_once_and_kept_for_the_next_start(folder, scene):
    first = Chooser(folder, size=96)._read_geometry(scene)
    with collecting(Report()) as report:
        again = Chooser(folder, size=96)._read_geometry(scene)
    assert (
        report.notes["cache.reused"] == ["match"]
        and report.notes["cache.computed"] == []
    )
    assert torch.equal(first.depths, again.depths)


def test_words_that_nobody_knows_are_asked_back(folder, scene):
    with pytest.raises(InputError, match="frobnicator"):
        Chooser(folder, size=96).masks(scene, Draft(words="the frobnicator"))
