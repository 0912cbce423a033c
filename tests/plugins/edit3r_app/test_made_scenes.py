"""Scenes to try: made once, opened again, small."""

from dataclasses import replace

import pytest
from edit3r_app.jobs import JobsFolder
from edit3r_app.made_scenes import MADE, PHOTOS, offered_scenes, open_made, photo_of

from edit3r.contract.errors import InputError


def test_three_scenes_are_offered_from_small_photos_that_are_there():
    assert len(list(offered_scenes())) == 3
    assert all(len(one.photos) == 2 for one in MADE.values())
    assert sum(file.stat().st_size for file in PHOTOS.iterdir()) < 150_000


def test_a_scene_is_made_once_and_opened_again(tmp_path):
    folder = JobsFolder(tmp_path)
    first = open_made(folder, "night", 128)
    assert open_made(folder, "night", 128) == first
    job = folder.job(first["at"])
    assert (job.prompt, job.state, job.size) == ("make it night", "queued", 128)
    assert open_made(folder, "sky", 128)["scene"] != first["scene"]
    folder.new_scene("night")  # a user's own of that name is another one
    assert open_made(folder, "night", 128) == first


def test_one_that_failed_is_made_again(tmp_path):
    folder = JobsFolder(tmp_path)
    first = open_made(folder, "night", 128)
    folder.write(replace(folder.job(first["at"]), state="failed"))
    again = open_made(folder, "night", 128)
    assert again["scene"] == first["scene"] and again["at"] != first["at"]


@pytest.mark.parametrize("name", ["", "moon", "../made"])
def test_others_are_refused(tmp_path, name):
    with pytest.raises(InputError, match="no made scene"):
        open_made(JobsFolder(tmp_path), name, 128)
    with pytest.raises(InputError, match="no made scene"):
        photo_of(name)
