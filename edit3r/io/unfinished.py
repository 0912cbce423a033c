"""Folders that a run is still writing to, and those that a killed run left.

A run holds a lock (flock) on a file inside its unfinished folder; the operating system releases it when the process
ends, however it ends. A folder whose lock can be taken belongs to nobody; one without a lock file is left alone.
"""

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nothing is removed there
    fcntl = None

LOCK = ".edit3r-writing"


def unfinished_name(final: Path) -> Path:
    """A new hidden name beside `final`."""
    return final.with_name(f".{final.name}.partial-{secrets.token_hex(4)}")


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Hold the lock on `folder`; its file is gone afterwards."""
    if fcntl is None:
        yield
        return
    lock = folder / LOCK
    with lock.open("w") as file:
        _try_lock(file)
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def remove_abandoned(final: Path) -> list[Path]:
    """Delete what killed runs into `final` left beside it; returns the folders that are gone."""
    if fcntl is None:
        return []
    folders = [folder for folder in final.parent.glob(f".{final.name}.partial-*") if _abandoned(folder)]
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
    return [folder for folder in folders if not folder.exists()]


def _abandoned(folder: Path) -> bool:
    if folder.is_symlink() or not folder.is_dir():
        return False
    try:
        with (folder / LOCK).open("r+") as file:
            return _try_lock(file)
    except OSError:  # no lock file, or not ours to touch
        return False


def _try_lock(file) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by a living process, or a file system without locks
        return False
    return True
