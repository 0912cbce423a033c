"""A scene that is dropped: its pictures are what the page shows, and its own file is edited."""

import pytest
from edit3r_app import sessions, uploads
from edit3r_app.draft import Draft, Mark
from edit3r_app.jobs import AppJob, JobsFolder
from edit3r_app.preview_service import PreviewService
from edit3r_app.runner import command_of
from edit3r_app.uploads import accept, looked_at, most_bytes, refuse_unwanted, remove

import edit3r
from edit3r.contract.errors import InputError
from edit3r.kit.scenes.ply import save_ply
from tests.plugins.scan import scan


@pytest.fixture(scope="module")
def dropped(tmp_path_factory):
    """A jobs folder with a scene that was dropped."""
    root = tmp_path_factory.mktemp("jobs")
    folder = JobsFolder(root)
    scene = folder.new_scene("scan")
    draft = root / "sent"
    save_ply(draft, scan())
    accept(folder, scene, "scan.ply", draft)
    return folder, scene


def test_a_dropped_scene_is_kept_with_pictures_of_it(dropped):
    folder, scene = dropped
    assert len(folder.photos(scene)) == 8
    file, cameras = folder.splat(scene)
    assert file.name == "scan.ply"
    assert cameras.is_file()


def test_a_scene_is_dropped_alone_and_keeps_its_pictures(dropped):
    folder, scene = dropped
    with pytest.raises(InputError, match="by itself"):
        refuse_unwanted(folder, scene, "more.jpg", 100)
    with pytest.raises(InputError, match="belong to the scene"):
        remove(folder, scene, "place_1")


def test_what_was_just_dropped_is_not_read_again(dropped, monkeypatch):
    folder, scene = dropped
    looker = PreviewService(folder, edit3r.default_registry(), 512)
    kept = folder.splat(scene)[0]
    assert looked_at(kept).file == kept
    assert looked_at(kept) is None  # it is not held twice
    uploads.turn_upright(folder, scene, "-y")
    monkeypatch.setattr(sessions, "make_scene_input", None)  # called, it would raise
    given = looker.sessions.scene_of(scene)
    assert given.places.up == (0, -1, 0)


def test_another_axis_upwards_turns_the_pictures_until_something_was_made(dropped):
    folder, scene = dropped
    first = folder.photos(scene)["place_1"].read_bytes()
    uploads.turn_upright(folder, scene, "+y")
    assert folder.photos(scene)["place_1"].read_bytes() != first
    uploads.turn_upright(folder, scene, "-y")
    assert folder.photos(scene)["place_1"].read_bytes() == first
    with pytest.raises(InputError, match="--up up: a given scene keeps its axes"):
        uploads.turn_upright(folder, scene, "up")
    other = folder.new_scene("photos")
    with pytest.raises(InputError, match="nothing was made of"):
        uploads.turn_upright(folder, other, "+y")


def test_what_is_no_scene_is_refused_and_leaves_nothing(tmp_path):
    folder = JobsFolder(tmp_path)
    scene = folder.new_scene("mesh")
    draft = tmp_path / "sent"
    draft.write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"
    )
    with pytest.raises(InputError, match="does not hold 3D Gaussians"):
        accept(folder, scene, "mesh.ply", draft)
    assert folder.splat(scene) is None
    assert not folder.photos(scene)


def test_a_scene_may_be_larger_than_a_photo():
    assert most_bytes("a.ply") > most_bytes("a.jpg")


def test_its_edit_runs_on_the_file_from_the_pictures_cameras(dropped):
    folder, scene = dropped
    job = folder.new_job(AppJob("", scene, settings={"prompt": "paint it blue"}))
    file, cameras = folder.splat(scene)
    command = command_of(folder, job)
    assert command[-3:] == [str(file), "--cameras", str(cameras)]


@pytest.mark.slow
def test_what_is_drawn_on_one_picture_is_answered_on_all(dropped):
    folder, scene = dropped
    looker = PreviewService(folder, edit3r.default_registry(), 512)
    box = [(0.3, 0.3), (0.6, 0.3), (0.6, 0.6), (0.3, 0.6)]
    draft = Draft([Mark("lasso", "place_1", box)])
    draft.form["prompt"] = "paint it blue"
    look = looker.look(scene, draft)
    assert look.job is not None, look.problem
    assert look.job.scene is not None
    shown = (look.masks > 0.5).flatten(1).any(1)
    assert shown.float().mean() > 0.7


def test_a_scene_that_an_edit_was_made_of_keeps_its_pictures(tmp_path):
    folder = JobsFolder(tmp_path)
    scene = folder.new_scene("scan")
    draft = tmp_path / "sent"
    save_ply(draft, scan())
    accept(folder, scene, "scan.ply", draft)
    folder.new_job(AppJob("", scene, settings={"prompt": "paint it blue"}))
    before = folder.photos(scene)["place_1"].read_bytes()
    with pytest.raises(InputError, match="nothing was made of"):
        uploads.turn_upright(folder, scene, "+y")
    assert folder.photos(scene)["place_1"].read_bytes() == before
