"""What killed runs left goes; what a living run writes to stays."""

import subprocess
import sys
import textwrap

import pytest

from edit3r.io.run_folder import atomic_folder
from edit3r.io.unfinished import LOCK, remove_abandoned, unfinished_name, writing

pytest.importorskip("fcntl")


def test_what_a_killed_run_left_is_removed_by_the_next_one(tmp_path):
    out = tmp_path / "out"
    killed = textwrap.dedent(f"""
        import os
        from edit3r.io.run_folder import atomic_folder
        with atomic_folder({str(out)!r}) as folder:
            (folder / "half").write_text("x")
            os._exit(9)
    """)
    assert subprocess.run([sys.executable, "-c", killed], check=False).returncode == 9
    assert len(list(tmp_path.glob(".out.partial-*"))) == 1
    with atomic_folder(out) as folder:
        (folder / "whole").write_text("x")
    assert [path.name for path in tmp_path.iterdir()] == ["out"] and not (out / LOCK).exists()


def test_the_folder_of_a_living_run_stays(tmp_path):
    out, folder = tmp_path / "out", unfinished_name(tmp_path / "out")
    folder.mkdir()
    with writing(folder):
        assert remove_abandoned(out) == [] and folder.exists()
    assert not (folder / LOCK).exists()


def test_folders_without_a_lock_and_of_other_names_stay(tmp_path):
    for name in (".out.partial-12345678", ".other.partial-12345678"):
        (tmp_path / name).mkdir()
    (tmp_path / ".other.partial-12345678" / LOCK).touch()
    (tmp_path / ".out.partial-link").symlink_to(tmp_path / ".other.partial-12345678")
    assert remove_abandoned(tmp_path / "out") == [] and len(list(tmp_path.iterdir())) == 3
