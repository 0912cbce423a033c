"""What can be taken along: by every writer, also what the run did not write."""

import zipfile

import pytest
import torch
from edit3r_app.downloads import offered_files, prepared
from edit3r_app.jobs import JobsFolder

from edit3r import Cameras, save_ply
from edit3r.contract.errors import InputError
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.photos.images import save_image
from edit3r.loading.registry import default_registry
from edit3r_testing import gaussian_cloud


@pytest.fixture
def folder(tmp_path):
    """A jobs folder with the run `run`, which kept its scene and images alone."""
    made = JobsFolder(tmp_path / "jobs")
    run = made.root / "run"
    (run / "edited").mkdir(parents=True)
    save_ply(run / "scene.ply", gaussian_cloud(20))
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])[None, None]
    cameras = Cameras(torch.eye(4)[None, None], lens, (8, 8))
    write_cameras(run / "cameras.json", posed_cameras(cameras, ["inputs/a.png"]))
    save_image(torch.rand(3, 8, 8), run / "edited" / "a.png")
    return made


def test_every_writer_is_offered_with_what_it_keeps_and_loses(folder):
    told = {one["file"]: one for one in offered_files(folder, "run")}
    for offer in default_registry().offers("writer"):
        one = offer.component
        name = one.file_name() + (".zip" if one.makes_folder else "")
        if name != "scene.ply":  # which every run has
            assert (told[name]["keeps"], told[name]["loses"]) == (one.keeps, one.loses)


def test_what_the_run_did_not_write_is_made_once(folder):
    page = prepared(folder, "run", "viewer.html")
    assert "<canvas" in page.read_text(encoding="utf-8")
    assert page.parent == folder.beside("run")
    changed = page.stat().st_mtime_ns
    assert prepared(folder, "run", "viewer.html").stat().st_mtime_ns == changed


def test_a_folder_is_sent_as_an_archive(folder):
    with zipfile.ZipFile(prepared(folder, "run", "scene-colmap.zip")) as archive:
        names = set(archive.namelist())
    assert {
        "scene-colmap/images/a.png",
        "scene-colmap/sparse/0/images.bin",
    } <= names


@pytest.mark.parametrize("what", ["viewer.html", "flight.webm"])
def test_a_link_is_never_sent(folder, what, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("secret")
    for place in (folder.root / "run", folder.beside("run")):
        (place / what).symlink_to(secret)
    if what == "flight.webm":
        with pytest.raises(InputError, match="not a file of a run"):
            prepared(folder, "run", what)
        return
    assert "<canvas" in prepared(folder, "run", what).read_text(encoding="utf-8")
    assert secret.read_text() == "secret"  # and not written through


@pytest.mark.parametrize(
    ("what", "told"),
    [("../x", "not a file of a run"), ("run.json", "its settings left it out")],
)
def test_what_is_no_download_is_refused(folder, what, told):
    with pytest.raises(InputError, match=told):
        prepared(folder, "run", what)


def test_each_download_says_what_it_is_for_and_its_size(folder):
    files = {one["file"]: one for one in offered_files(folder, "run")}
    assert all(one["what"] for one in files.values())
    assert files["scene.ply"]["bytes"] == (folder.root / "run/scene.ply").stat().st_size
    assert files["viewer.html"]["bytes"] is None  # made when asked for
    prepared(folder, "run", "viewer.html")
    again = {one["file"]: one["bytes"] for one in offered_files(folder, "run")}
    assert again["viewer.html"] > 1000
