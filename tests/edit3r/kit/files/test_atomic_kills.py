"""Writers that are killed at every step of the method, and several at one place."""

import shutil
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from edit3r.kit.files import atomic
from edit3r.kit.files.atomic import MARKER, atomic_folder, atomic_write

FILES = ("a.txt", "b/c.txt")


def write_folder(out, text):
    with atomic_folder(out) as folder:
        (folder / "b").mkdir()
        for name in FILES:
            (folder / name).write_text(text)


def write_file(path, text):
    with atomic_write(path) as partial:
        partial.write_text(text)


def content(out):
    """The one text that a file, or all files of a whole folder, hold; None where nothing is."""
    files = [out / name for name in FILES] if out.is_dir() else [out]
    texts = {file.read_text() for file in files if out.exists()}
    assert len(texts) <= 1, texts
    return texts.pop() if texts else None


def left_in(folder):
    return {path.name for path in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("earlier", [None, "old"])
@pytest.mark.parametrize("write", [write_file, write_folder])
def test_a_writer_killed_at_every_step(tmp_path, killed_at, earlier, write):
    seen = set()
    for step in count():
        out = tmp_path / str(step) / "out"
        out.parent.mkdir()
        if earlier:
            write(out, earlier)
        killed = killed_at(step, out.parent, lambda: write(out, "new"))  # noqa: B023
        seen.add(content(out))
        atomic.remove_abandoned(out)  # what the next start does first
        assert content(out) in (earlier, "new"), step
        assert left_in(out.parent) <= {"out"}, step
        if not killed:
            break
    # Between two renames there is an instant in which nothing has the name.
    instant = {None} if write is write_folder else set()
    assert step > 5 and seen | instant == {earlier, "new"} | instant


@pytest.mark.parametrize("write", [write_file, write_folder])
def test_the_next_writer_removes_what_a_killed_one_left(tmp_path, killed_at, write):
    out = tmp_path / "out"
    assert killed_at(4, tmp_path, lambda: write(out, "new"))
    assert left_in(tmp_path) not in (set(), {"out"})
    write(out, "next")
    assert content(out) == "next" and left_in(tmp_path) == {"out"}


MANY = """
import sys
from edit3r.contract.errors import Edit3rError
from edit3r.kit.files.atomic import atomic_folder
for round in range(20):
    try:
        with atomic_folder(sys.argv[1]) as folder:
            for name in ("a.txt", "c.txt"):
                (folder / name).write_text(sys.argv[2])
    except Edit3rError as error:
        print(error)
"""


@pytest.mark.slow
def test_three_processes_at_one_folder(tmp_path):
    out = tmp_path / "out"
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", MANY, out, str(index)], stderr=subprocess.PIPE
        )
        for index in range(3)
    ]
    errors = [process.communicate()[1].decode() for process in processes]
    assert not any(errors), errors
    assert len({(out / name).read_text() for name in ("a.txt", "c.txt")}) == 1
    left = {name for name in left_in(tmp_path) if "-finished-" not in name}
    assert left == {"out"}


@pytest.mark.parametrize("looks", range(1, 7))
def test_a_folder_that_goes_while_it_is_looked_at_may_be_written(
    tmp_path, monkeypatch, looks
):
    """Another run moves its own into place: for a moment there is none."""
    out, real, seen = tmp_path / "out", Path.stat, []
    out.mkdir()

    def stat(path, **options):
        seen.append(path)
        if seen.count(out) == looks:
            shutil.rmtree(out, ignore_errors=True)
        return real(path, **options)

    monkeypatch.setattr(Path, "stat", stat)
    atomic.check_replaceable(out)


def test_the_folder_of_a_living_run_and_names_of_others_stay(tmp_path):
    others = [".out.partial-12345678", ".other.partial-12345678", ".out.partial-mine"]
    for name in others:
        (tmp_path / name).mkdir()
    (tmp_path / others[0] / "thesis.tex").touch()  # no lock says that this is ours
    with atomic_folder(tmp_path / "out") as folder:
        atomic.remove_abandoned(tmp_path / "out")
        assert folder.exists()
    assert left_in(tmp_path / "out") == {MARKER}
    assert left_in(tmp_path) == {"out", *others}
