"""Marks in a file, and masks from them."""

import io
from pathlib import Path

import pytest
import torch
from edit3r_app import uploads
from edit3r_app.choosing import Chooser, Draft, read_draft, write_draft
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
    return uploads.copied(folder, "motorcycle", [Path(file) for file in packaged_pair()[0]])


def test_a_draft_survives_a_restart(folder, scene):
    draft = Draft([(0, 0.5, 0.5)], [(1, 0.1, 0.2)], {1: (0.1, 0.1, 0.3, 0.3)}, "sky", True, {"prompt": "gold"})
    write_draft(folder, scene, draft)
    assert read_draft(JobsFolder(folder.root), scene) == draft


@pytest.mark.parametrize("content", ["", "[]", '{"positive": [[0, "x", 1]]}', '{"boxes": {"a": 1}}'])
def test_a_damaged_draft_is_an_empty_one(folder, scene, content):
    (folder.beside(scene) / "draft.json").write_text(content)
    assert read_draft(folder, scene) == Draft()


def test_more_clicks_than_anybody_makes_are_refused(folder, scene):
    with pytest.raises(InputError, match="200 clicks"):
        write_draft(folder, scene, Draft([(0, 0.5, 0.5)] * 201))


def test_a_click_gives_a_mask_on_every_photo_and_files_for_the_run(folder, scene):
    chooser, draft = Chooser(folder, size=96), Draft([(0, 0.5, 0.5)])
    assert chooser.masks(scene, Draft()) is None and chooser.save_masks(scene, Draft(), "job") == 0
    found = chooser.masks(scene, draft)
    assert found.masks.shape == (2, 1, *chooser.views(scene).image_size) and (found.masks[0] > 0.5).any()
    assert chooser.masks(scene, draft) is found  # asked for again by every picture
    assert chooser.save_masks(scene, draft, "job") == 2
    saved = Image.open(folder.beside("job") / "000.png").convert("L")
    assert saved.size == chooser.views(scene).image_size[::-1] and saved.getextrema()[1] > 127
    plain, marked = (Image.open(io.BytesIO(chooser.picture(scene, one, 0))) for one in (Draft(), draft))
    assert plain.size == marked.size and plain.tobytes() != marked.tobytes()


def test_geometry_is_read_once_and_kept_for_the_next_start(folder, scene):
    first = Chooser(folder, size=96)._read_geometry(scene)
    with collecting(Report()) as report:
        again = Chooser(folder, size=96)._read_geometry(scene)
    assert report.notes["cache.reused"] == ["match"] and report.notes["cache.computed"] == []
    assert torch.equal(first.depths, again.depths)


def test_words_that_nobody_knows_are_asked_back(folder, scene):
    with pytest.raises(InputError, match="frobnicator"):
        Chooser(folder, size=96).masks(scene, Draft(words="the frobnicator"))
