import os
import subprocess
import sys
import textwrap
import time

import pytest

from edit3r.errors import InputError, RunError
from edit3r.io import atomic
from edit3r.io.atomic import MARKER, atomic_folder, atomic_write
from edit3r.io.run_folder import RunFolder


def make_run(out, text="old"):
    with atomic_folder(out) as folder:
        (RunFolder(folder).inputs / "a.png").write_text(text)
        RunFolder(folder).scene.write_text(text)


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
    assert (
        left_in(tmp_path) == ["out"]
        and (tmp_path / "out" / "scene.ply").read_text() == "old"
    )


@pytest.mark.parametrize("in_one_step", [True, False])
def test_an_earlier_run_is_replaced_as_a_whole(tmp_path, monkeypatch, in_one_step):
    if not in_one_step:
        monkeypatch.setattr(atomic, "_exchange_in_one_step", lambda new, old: False)
    make_run(tmp_path / "out")
    with atomic_folder(tmp_path / "out") as folder:
        (folder / "run.json").write_text("new")
    assert left_in(tmp_path / "out") == [MARKER, "run.json"] and left_in(tmp_path) == [
        "out"
    ]


def test_folders_of_others_are_refused_at_once_and_untouched(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("precious")
    with pytest.raises(
        InputError,
        match=r"out: holds files that are not from an earlier run \(such as thesis.tex\)",
    ):
        make_run(tmp_path / "out")
    assert left_in(tmp_path) == ["out"]


def test_an_earlier_run_with_a_note_added_is_refused(tmp_path):
    make_run(tmp_path / "out")
    (tmp_path / "out" / "inputs" / "note.txt").write_text("mine")
    with pytest.raises(InputError, match=r"inputs/note\.txt"):
        make_run(tmp_path / "out", "new")
    assert (tmp_path / "out" / "scene.ply").read_text() == "old"


@pytest.mark.parametrize(
    "change", ["edited", "empty folder", "same size", "older file"]
)
def test_an_earlier_run_that_was_changed_by_hand_is_replaced_only_when_asked(
    tmp_path, change
):
    out = tmp_path / "out"
    make_run(out)
    changed = out / ("notes" if change == "empty folder" else "scene.ply")
    if change == "empty folder":
        changed.mkdir()
    else:
        time.sleep(0.01)  # coarser than the clock of file times
        changed.write_text("mine!" if change == "edited" else "own")
        if change == "older file":
            os.utime(changed, (1, 1))
    with pytest.raises(
        InputError, match=rf"{changed.name} was added or changed by hand.*--overwrite"
    ):
        make_run(out, "new")
    assert changed.exists() and left_in(tmp_path) == ["out"]
    with atomic_folder(out, overwrite=True) as folder:
        (folder / "scene.ply").write_text("new")
    assert left_in(out) == [MARKER, "scene.ply"] and left_in(tmp_path) == ["out"]


def test_overwrite_never_replaces_what_no_run_wrote(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with (
        pytest.raises(InputError, match="not from an earlier run"),
        atomic_folder(tmp_path, overwrite=True),
    ):
        pass
    assert left_in(tmp_path) == ["thesis.tex"]


@pytest.mark.parametrize("in_one_step", [True, False])
def test_the_old_result_stays_when_the_new_one_is_gone(
    tmp_path, monkeypatch, in_one_step
):
    if not in_one_step:
        monkeypatch.setattr(atomic, "_exchange_in_one_step", lambda new, old: False)
    make_run(tmp_path / "out")
    with (
        pytest.raises(RunError, match="another program took"),
        atomic_folder(tmp_path / "out") as folder,
    ):
        folder.rmdir()
    assert (
        left_in(tmp_path) == ["out"]
        and (tmp_path / "out" / "scene.ply").read_text() == "old"
    )


def test_an_empty_folder_is_used_and_a_file_refused(tmp_path):
    (tmp_path / "out").mkdir()
    make_run(tmp_path / "out")
    assert (tmp_path / "out" / "scene.ply").exists()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file of that name exists"):
        make_run(tmp_path / "file")


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be created"):
        make_run(tmp_path / "file" / "out")


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


REPLACING = """
    import sys
    from edit3r.io.atomic import atomic_folder
    print("ready", flush=True)
    while True:
        with atomic_folder(sys.argv[1]) as folder:
            for index in range(20):
                (folder / f"{index}.txt").write_text("whole")
"""


@pytest.mark.skipif(
    not sys.platform.startswith(("linux", "darwin")),
    reason="replacing is in one step only there",
)
def test_a_kill_at_any_moment_leaves_a_whole_result(tmp_path):
    out = tmp_path / "out"
    make_run(out)
    for delay in (0.002, 0.005, 0.009, 0.014, 0.02):
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(REPLACING), str(out)],
            stdout=subprocess.PIPE,
        )
        process.stdout.readline()
        time.sleep(delay)
        process.kill()
        process.wait()
        process.stdout.close()
        files = left_in(out)
        assert "scene.ply" in files or len(files) == 21, files


def test_atomic_write_replaces_only_when_it_ends_well(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_write(tmp_path / "a.txt") as partial:
        partial.write_text("half")
        raise ZeroDivisionError
    assert (tmp_path / "a.txt").read_text() == "old" and left_in(tmp_path) == ["a.txt"]
    with atomic_write(tmp_path / "a.txt") as partial:
        assert partial.suffix == ".txt"
        partial.write_text("new")
    assert (tmp_path / "a.txt").read_text() == "new" and left_in(tmp_path) == ["a.txt"]


def test_atomic_write_into_no_folder_or_onto_one_is_an_error(tmp_path):
    for path, expected in (
        (tmp_path / "none" / "a.txt", "there is no folder"),
        (tmp_path, "it is a folder"),
    ):
        with pytest.raises(InputError, match=expected), atomic_write(path):
            pass


@pytest.mark.skipif(
    os.name == "nt" or os.geteuid() == 0, reason="root may write everywhere"
)
def test_unwritable_folder_is_one_sentence(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be created"):
        make_run(tmp_path / "out")
    tmp_path.chmod(0o700)
