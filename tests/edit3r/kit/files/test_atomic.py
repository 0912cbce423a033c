import os
import tempfile

import pytest

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.files.atomic import (
    MARKER,
    atomic_folder,
    atomic_write,
    check_apart,
    check_new_file,
    scratch_folder,
)


def make_run(out, text="old", **options):
    with atomic_folder(out, **options) as folder:
        (folder / "inputs").mkdir()
        (folder / "inputs" / "a.png").write_text(text)
        (folder / "scene.ply").write_text(text)


def left_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_results_appear_only_when_whole(tmp_path):
    out = tmp_path / "new" / "out"
    with atomic_folder(out) as folder:
        (folder / "scene.ply").write_text("x")
        assert not out.exists()
    assert left_in(out) == [MARKER, "scene.ply"] and left_in(out.parent) == ["out"]


def test_a_run_that_raises_leaves_nothing_and_keeps_the_earlier_one(tmp_path):
    make_run(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "out") as folder:
        (folder / "scene.ply").write_text("new")
        raise KeyboardInterrupt
    assert left_in(tmp_path) == ["out"]
    assert (tmp_path / "out" / "scene.ply").read_text() == "old"


def test_an_earlier_run_is_replaced_as_a_whole(tmp_path):
    make_run(tmp_path / "out")
    with atomic_folder(tmp_path / "out") as folder:
        (folder / "run.json").write_text("new")
    assert left_in(tmp_path / "out") == [MARKER, "run.json"]
    assert left_in(tmp_path) == ["out"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_folders_of_others_are_refused_at_once_and_untouched(tmp_path, overwrite):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match=r"not from an earlier run .*thesis.tex"):
        make_run(tmp_path / "out", overwrite=overwrite)
    assert left_in(tmp_path) == ["out"] and left_in(tmp_path / "out") == ["thesis.tex"]


CHANGES = {
    "inputs/note.txt": lambda path: path.write_text("mine"),
    "notes": lambda path: path.mkdir(),
    "scene.ply": lambda path: path.write_text("longer"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_run_that_was_changed_by_hand_is_replaced_only_when_asked(tmp_path, name):
    out = tmp_path / "out"
    make_run(out)
    CHANGES[name](out / name)
    expected = rf"{name} was added or changed by hand.*--overwrite"
    with pytest.raises(InputError, match=expected):
        make_run(out, "new")
    assert (out / name).exists() and left_in(tmp_path) == ["out"]
    make_run(out, "new", overwrite=True)
    assert left_in(out) == [MARKER, "inputs", "scene.ply"]
    assert left_in(tmp_path) == ["out"]


def test_the_old_result_stays_when_the_new_one_is_gone(tmp_path):
    make_run(tmp_path / "out")
    with (
        pytest.raises(RunError, match="another program took"),
        atomic_folder(tmp_path / "out") as folder,
    ):
        folder.rmdir()
    assert left_in(tmp_path) == ["out"]
    assert (tmp_path / "out" / "scene.ply").read_text() == "old"


def test_the_old_result_comes_back_where_the_new_one_cannot_be_moved(
    tmp_path, monkeypatch
):
    make_run(tmp_path / "out")
    rename = os.rename

    def fails(new, place):
        if place == tmp_path / "out" and not str(new).endswith(".old"):
            raise OSError("the disk is gone")
        rename(new, place)

    monkeypatch.setattr(os, "rename", fails)
    with pytest.raises(RunError, match="the disk is gone The finished results are in"):
        make_run(tmp_path / "out", "new")
    assert (tmp_path / "out" / "scene.ply").read_text() == "old"
    (kept,) = tmp_path.glob("out-finished-*")
    assert (kept / "scene.ply").read_text() == "new"


def test_an_empty_folder_is_used_and_a_file_refused(tmp_path):
    (tmp_path / "out").mkdir()
    make_run(tmp_path / "out")
    assert (tmp_path / "out" / "scene.ply").exists()
    (tmp_path / "file").touch()
    for name, expected in (
        ("file", "file of that name exists"),
        ("file/out", "cannot be created"),
    ):
        with pytest.raises(InputError, match=expected):
            make_run(tmp_path / name)


def test_finished_results_are_kept_when_the_place_was_taken_meanwhile(tmp_path):
    with (
        pytest.raises(RunError, match=r"The finished results are in .*out-finished-"),
        atomic_folder(tmp_path / "out") as folder,
    ):
        (folder / "scene.ply").write_text("new")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "other.txt").touch()
    assert left_in(tmp_path / "out") == ["other.txt"]
    make_run(tmp_path / "out2")  # no later run takes it for left over
    (kept,) = tmp_path.glob("out-finished-*")
    assert (kept / "scene.ply").read_text() == "new"


def test_atomic_write_replaces_only_when_it_ends_well(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_write(path) as partial:
        partial.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old" and left_in(tmp_path) == ["a.txt"]
    with atomic_write(path) as partial:
        assert partial.suffix == ".txt"
        partial.write_text("new")
    assert path.read_text() == "new" and left_in(tmp_path) == ["a.txt"]


def test_what_cannot_be_written_is_one_sentence(tmp_path):
    places = {
        tmp_path / "none" / "a.txt": "there is no folder",
        tmp_path: "it is a folder",
    }
    if os.path.isdir("/proc/self"):
        places["/proc/self/a.txt"] = "no permission"
    for path, expected in places.items():
        with pytest.raises(InputError, match=expected), atomic_write(path):
            pass


@pytest.mark.parametrize("to_a_run", [True, False])
def test_a_link_leads_nowhere_that_was_not_meant(tmp_path, to_a_run):
    run, link = tmp_path / "run", tmp_path / "edit3r-out"
    if to_a_run:
        with atomic_folder(run) as folder:
            (folder / "mine").touch()
    link.symlink_to(run)
    with pytest.raises(InputError, match=r"a (broken )?link"), atomic_folder(link):
        pass
    assert run.exists() == to_a_run
    with pytest.raises(InputError, match=r"a (broken )?link"):
        check_new_file(link, overwrite=False)


def test_a_link_to_a_folder_of_ones_own_is_written_through(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    with atomic_folder(tmp_path / "out") as folder:
        (folder / "mine").touch()
    assert (tmp_path / "disk" / "mine").exists()


def test_what_a_kill_left_in_a_temporary_folder_goes_with_the_next_start(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = tmp_path / ".frames.partial-0123abcd"
    left.mkdir()
    (left / "edit3r.lock").touch()
    (left / "frame.png").touch()
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "edit3r.lock").touch()
    (mine / "kept.png").touch()
    link = tmp_path / ".frames.partial-89abcdef"
    link.symlink_to(mine)
    with scratch_folder("frames") as folder:
        assert not left.exists() and folder.parent == tmp_path
        with scratch_folder("frames") as other:
            assert folder.is_dir() and folder != other
    assert sorted(tmp_path.iterdir()) == [link, mine] and len(left_in(mine)) == 2


@pytest.mark.parametrize(
    "change",
    [
        lambda out: (out / "scene.ply").write_text("PLY"),  # of the same size
        lambda out: (out / "more" / "a.bin").write_bytes(b"\0\1"),
        lambda out: (out / "scene.ply").write_text("plyy"),
        lambda out: (out / "scene.ply").chmod(0o600) or (out / "new").touch(),
        lambda out: (out / "empty").mkdir(),
        lambda out: (
            (out / "scene.ply").unlink() or (out / "scene.ply").symlink_to("more/a.bin")
        ),
        lambda out: (out / "scene.ply").rename(out / "other.ply"),
        lambda out: (out / MARKER).write_text("{"),
    ],
    ids=["same size", "inside", "longer", "new", "folder", "link", "renamed", "marker"],
)
def test_what_was_changed_by_hand_is_not_replaced_unasked(tmp_path, change):
    def make(overwrite=False):
        with atomic_folder(tmp_path / "out", overwrite) as folder:
            (folder / "scene.ply").write_text("ply")
            (folder / "more").mkdir()
            (folder / "more" / "a.bin").write_bytes(b"\0\0")

    make()
    make()  # as it was left: replaced
    change(tmp_path / "out")
    before = sorted(path.name for path in (tmp_path / "out").rglob("*"))
    with pytest.raises(InputError, match=r"changed by hand|not from an earlier"):
        make()
    assert sorted(path.name for path in (tmp_path / "out").rglob("*")) == before
    make(overwrite=True)


def test_an_empty_name_is_called_empty(tmp_path):
    with pytest.raises(InputError, match="--out is empty"):
        check_apart("", tmp_path / "a.jpg")
