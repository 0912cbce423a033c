"""Writers that are killed at every step of the protocol, and several at one place: nothing lost,
mixed or left.
"""

import os
import subprocess
import sys
import textwrap

import pytest

from edit3r.io import atomic
from edit3r.io.atomic import MARKER, atomic_folder, atomic_write

pytestmark = pytest.mark.skipif(atomic.fcntl is None, reason="no file locks here")

STEPS = ("open", "os.", "fcntl.", "shutil.", "ctypes.")
FILES = ("a.txt", "b/c.txt")


def write_folder(out, text):
    with atomic_folder(out) as folder:
        (folder / "b").mkdir()
        for name in FILES:
            (folder / name).write_text(text)


def write_file(path, text):
    with atomic_write(path) as partial:
        partial.write_text(text)


def killed_at(step, write):
    """Call `write` in a process that ends without a word before its `step`-th system call; False:
    it had fewer.
    """
    child = os.fork()
    if child == 0:
        left = step

        def count(event, arguments):
            nonlocal left
            if event.startswith(STEPS):
                left -= 1
                if left < 0:
                    os._exit(9)

        sys.addaudithook(count)
        try:
            write()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def content(out):
    """The one text that all files of a whole folder hold; None where there is no folder."""
    if not out.exists():
        return None
    (text,) = {(out / name).read_text() for name in FILES}
    return text


@pytest.mark.parametrize("in_one_step", [True, False])
@pytest.mark.parametrize("earlier", [None, "old"])
def test_a_folder_killed_at_every_step(tmp_path, monkeypatch, earlier, in_one_step):
    if not in_one_step:
        monkeypatch.setattr(atomic, "_exchange_in_one_step", lambda new, old: False)
    seen, step = set(), 0
    while True:
        place = tmp_path / str(step)
        place.mkdir()
        out = place / "out"
        if earlier:
            write_folder(out, earlier)
        killed = killed_at(step, lambda: write_folder(out, "new"))  # noqa: B023
        seen.add(content(out))
        atomic.remove_abandoned(out, "out", "")  # what the next start does first
        assert content(out) in (earlier, "new") and {
            path.name for path in place.iterdir()
        } <= {"out"}, step
        write_folder(out, "next")
        assert content(out) == "next" and [path.name for path in place.iterdir()] == [
            "out"
        ], step
        if not killed:
            break
        step += 1
    between = (
        set() if in_one_step else {None}
    )  # three renames, and an instant without a folder of that name
    assert seen == {earlier, "new"} | between and step > 10


@pytest.mark.parametrize("earlier", [None, "old"])
def test_a_file_killed_at_every_step(tmp_path, earlier):
    step, killed = 0, True
    while killed:
        place = tmp_path / str(step)
        place.mkdir()
        if earlier:
            write_file(place / "a.txt", earlier)
        killed = killed_at(step, lambda: write_file(place / "a.txt", "new"))  # noqa: B023
        found = (place / "a.txt").read_text() if (place / "a.txt").exists() else None
        assert found in (earlier, "new"), step
        write_file(place / "a.txt", "next")
        assert [path.name for path in place.iterdir()] == ["a.txt"], step
        step += 1
    assert step > 5


MANY = """
    import sys
    from edit3r.io.atomic import atomic_folder
    for round in range(40):
        with atomic_folder(sys.argv[1]) as folder:
            for name in ("a.txt", "c.txt"):
                (folder / name).write_text(sys.argv[2])
"""


def test_six_processes_at_one_folder(tmp_path):
    out = tmp_path / "out"
    program = [sys.executable, "-c", textwrap.dedent(MANY), str(out)]
    processes = [
        subprocess.Popen([*program, str(index)], stderr=subprocess.PIPE)
        for index in range(6)
    ]
    errors = [process.communicate()[1].decode() for process in processes]
    assert not any(errors), errors
    assert len({(out / name).read_text() for name in ("a.txt", "c.txt")}) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_folder_of_a_living_run_and_names_of_others_stay(tmp_path):
    (tmp_path / ".out.partial-12345678").mkdir()  # nobody's lock says that this is ours
    (tmp_path / ".other.partial-12345678").mkdir()
    (tmp_path / ".other.partial-12345678.lock").touch()
    with atomic_folder(tmp_path / "out") as folder:
        atomic.remove_abandoned(tmp_path / "out", "out", "")
        assert folder.exists()
    assert [path.name for path in (tmp_path / "out").iterdir()] == [MARKER]
    assert len(list(tmp_path.iterdir())) == 4
