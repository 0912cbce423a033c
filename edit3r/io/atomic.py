"""Files and folders that appear whole or not at all: written under a temporary name, then moved into place.

A kill at any moment leaves the old result or the new one under the final name, never half of one. A folder that a
killed run was writing to stays behind as `.NAME.partial-...`; the next run to the same place removes it. While a run
writes, it holds a lock (flock) on a file in that folder, which the operating system releases when the process ends:
a folder whose lock can be taken belongs to nobody, and one without a lock file is left alone.
"""

import ctypes
import json
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from edit3r.errors import InputError, RunError

try:
    import fcntl
except ImportError:  # Windows: no locks, and abandoned folders are not removed there
    fcntl = None

__all__ = ["LOCK", "MARKER", "atomic_folder", "atomic_write", "check_replaceable", "write_between"]

MARKER = ".edit3r-run"
"""In every finished folder: the list of its files. Only a folder that holds nothing else is ever replaced."""

LOCK = ".edit3r-writing"
"""In every unfinished folder: the file that its writer has locked."""

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2  # linux/fs.h
_RENAME_SWAP = 2  # macOS sys/stdio.h


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it when the block ends well, and vanishes when it raises.

    The temporary name keeps the suffix, since many writers choose the format by it. Raises InputError when the
    folder does not exist or cannot be written to.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written, there is no folder {path.parent}.")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written, it is a folder.")
    partial = path.with_name(f".{path.stem}.partial-{secrets.token_hex(4)}{path.suffix}")
    try:
        partial.touch()
        mode = partial.stat().st_mode
        yield partial
        partial.chmod(mode)  # safetensors makes files that only their owner can read
        os.replace(partial, path)
    except PermissionError:
        raise InputError(f"{path}: no permission to write there.") from None
    finally:
        partial.unlink(missing_ok=True)


def write_between(page: Path, start: str, end: str, text: str) -> None:
    """Replace what stands between the lines `start` and `end` of a text file; raises InputError where they are not.

    For pages that are written by hand but for one part, such as a measured table in the documentation.
    """
    before = page.read_text(encoding="utf-8")
    block = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
    if not block.search(before):
        raise InputError(f"{page}: has no lines {start!r} and {end!r} to write between.")
    with atomic_write(page) as partial:
        partial.write_text(block.sub(lambda _: f"{start}\n{text}{end}", before), encoding="utf-8")


@contextmanager
def atomic_folder(out: str | Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` when the block ends well, and vanishes when it raises.

    `out` may be new, empty, or an earlier run, which is then replaced in one step. Anything else is refused at once
    (InputError), so that nobody's files are lost and no minutes are spent before saying so.
    """
    final = Path(out).expanduser().resolve()
    check_replaceable(final)
    _remove_abandoned(final)
    partial = _make_partial(final)
    try:
        with _locked(partial):
            yield partial
        files = [name for name in _files(partial) if name != MARKER]
        (partial / MARKER).write_text(json.dumps({"files": files}, indent=1) + "\n", encoding="utf-8")
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    _move_into_place(partial, final)


def check_replaceable(out: Path) -> None:
    """Raise InputError unless a run may write to `out`: new, empty, or an untouched earlier run."""
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError(f"{out}: --out must be a folder, but a file of that name exists.")
    if out.is_mount():
        raise InputError(f"{out}: a mount point cannot be replaced in one step; give --out a folder inside it.")
    foreign = _foreign_files(out)
    if foreign:
        raise InputError(
            f"{out}: holds files that are not from an earlier run (such as {foreign[0]}); give --out another folder."
        )


def _foreign_files(folder: Path) -> list[str]:
    """Files that the folder's own list does not name."""
    try:
        listed = json.loads((folder / MARKER).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        listed = []
    known = {MARKER, *(name for name in listed if isinstance(name, str))}
    return [name for name in _files(folder) if name not in known]


def _files(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())


def _make_partial(final: Path) -> Path:
    """A new hidden folder beside `final`."""
    partial = final.with_name(f".{final.name}.partial-{secrets.token_hex(4)}")
    try:
        partial.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{final}: cannot be created ({error.strerror}); give --out another folder.") from None
    return partial


def _move_into_place(partial: Path, final: Path) -> None:
    try:
        check_replaceable(final)
        if final.exists():
            _exchange(partial, final)
            shutil.rmtree(partial, ignore_errors=True)
        else:
            os.rename(partial, final)
    except (InputError, OSError) as error:
        raise RunError(f"{error} The finished results are in {partial}.") from None


def _exchange(new: Path, old: Path) -> None:
    """Swap the names of two existing folders on one file system.

    One step on Linux and macOS. Elsewhere, or on a file system that cannot, two renames: between them, for an
    instant, nothing carries the name `old`, but both folders are whole.
    """
    if not _exchange_in_one_step(os.fsencode(new), os.fsencode(old)):
        aside = old.with_name(f"{new.name}-old")
        os.rename(old, aside)
        os.rename(new, old)
        os.rename(aside, new)


def _exchange_in_one_step(new: bytes, old: bytes) -> bool:
    if not sys.platform.startswith(("linux", "darwin")):
        return False
    library = ctypes.CDLL(None, use_errno=True)
    try:
        if sys.platform == "darwin":
            return library.renamex_np(new, old, _RENAME_SWAP) == 0
        return library.renameat2(_AT_FDCWD, new, _AT_FDCWD, old, _RENAME_EXCHANGE) == 0
    except AttributeError:  # a C library without the call
        return False


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock on an unfinished folder; its file is gone afterwards."""
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


def _remove_abandoned(final: Path) -> list[Path]:
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
