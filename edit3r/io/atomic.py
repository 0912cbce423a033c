"""Files and folders that appear whole or not at all: written under a temporary name, then moved
into place.

A kill at any moment leaves the old result or the new one under the final name, never half of one,
and perhaps a hidden `.NAME.partial-...` beside it. Beside that lies a lock file, made before
anything else and removed after everything else, whose lock (flock) the operating system releases
when the writer ends: what belongs to a lock file that can be locked is left over, and whoever
writes to the same place next removes it.
"""

import ctypes
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from edit3r.errors import InputError, RunError

try:
    import fcntl
except ImportError:  # Windows: no locks, and abandoned folders are not removed there
    fcntl = None

__all__ = [
    *("MARKER", "atomic_folder", "atomic_write", "check_replaceable"),
    *("remove_abandoned", "sha256_of", "write_between"),
]

MARKER = ".edit3r-run"
"""In every finished folder: what it holds. Only a folder that holds just that is replaced without
being asked to.
"""

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2  # linux/fs.h
_RENAME_SWAP = 2  # macOS sys/stdio.h


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it when the block ends well, and vanishes
    when it raises.

    The temporary name keeps the suffix, since many writers choose the format by it. Raises
    InputError when the folder does not exist or cannot be written to.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(
            f"{path}: cannot be written, there is no folder {path.parent}."
        )
    if path.is_dir():
        raise InputError(f"{path}: cannot be written, it is a folder.")
    try:
        with _claimed(path, path.stem, path.suffix) as partial:
            partial.touch()
            mode = partial.stat().st_mode
            yield partial
            partial.chmod(
                mode
            )  # safetensors makes files that only their owner can read
            os.replace(partial, path)
    except PermissionError:
        raise InputError(f"{path}: no permission to write there.") from None
    except (
        FileNotFoundError
    ) as error:  # a file system that takes no new files, such as /proc
        if error.filename is None or not Path(error.filename).name.startswith(
            f".{path.stem}.partial-"
        ):
            raise
        raise InputError(f"{path}: no file can be made there.") from None


def write_between(page: Path, start: str, end: str, text: str) -> None:
    """Replace what stands between the lines `start` and `end` of a text file; raises InputError
    where they are not.

    For pages that are written by hand but for one part, such as a measured table in the
    documentation.
    """
    before = page.read_text(encoding="utf-8")
    block = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
    if not block.search(before):
        raise InputError(
            f"{page}: has no lines {start!r} and {end!r} to write between."
        )
    with atomic_write(page) as partial:
        partial.write_text(
            block.sub(lambda _: f"{start}\n{text}{end}", before), encoding="utf-8"
        )


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file of any size."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 22):
            digest.update(block)
    return digest.hexdigest()


@contextmanager
def atomic_folder(out: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` when the block ends well, and vanishes when it
    raises.

    `out` may be new, empty, or an earlier run, which is then replaced in one step. An earlier run
    in which something was added or changed by hand is replaced only with `overwrite`. Anything else
    is refused at once (InputError), so that nobody's files are lost and no minutes are spent before
    saying so.
    """
    try:
        final = Path(out).expanduser().resolve()
        final.exists()
    except (
        OSError,
        ValueError,
        RuntimeError,
    ) as error:  # too long, a null byte, links in a circle, no home
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{str(out)[:200]!r}: cannot be a folder ({reason}); give --out another one."
        ) from None
    check_replaceable(final, overwrite)
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            partial = stack.enter_context(_claimed(final, final.name))
            partial.mkdir()
            claim = stack.pop_all()
    except OSError as error:
        raise InputError(
            f"{final}: cannot be created ({error.strerror}); give --out another folder."
        ) from None
    with claim:
        yield partial
        _move_into_place(partial, final, overwrite)


def check_replaceable(out: Path, overwrite: bool = False) -> None:
    """Raise InputError unless a run may write to `out`: new, empty, an earlier run, with
    `overwrite` a changed one.
    """
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError(
            f"{out}: --out must be a folder, but a file of that name exists."
        )
    if out.is_mount():
        raise InputError(
            f"{out}: a mount point cannot be replaced in one step; give --out a folder inside it."
        )
    is_run = (out / MARKER).is_file()
    changed = [] if overwrite and is_run else _changed(out)
    if changed and is_run:
        raise InputError(
            f"{out}: {changed[0]} was added or changed by hand after the earlier run; give --out "
            "another folder, or "
            "--overwrite to replace it all."
        )
    if changed:
        raise InputError(
            f"{out}: holds files that are not from an earlier run (such as {changed[0]}); give "
            "--out another folder."
        )


def _changed(folder: Path) -> list[str]:
    """What lies in the folder and is not what its marker lists, or was written after the marker."""
    for _ in range(100):
        before = _identity(folder)
        (listed, written), found = _read_marker(folder), _entries(folder)
        if (
            _identity(folder) == before
        ):  # else another run has replaced the folder meanwhile
            break
    same = {
        name
        for name, (size, time) in found.items()
        if listed.get(name, "") == size and (time or 0) <= written
    }
    return sorted(set(found) - same - {MARKER})


def _read_marker(folder: Path) -> tuple[dict[str, int | None], int]:
    """What the folder's marker lists and when it was written [ns]; nothing where there is none that
    can be read.
    """
    marker = folder / MARKER
    try:
        listed, written = (
            json.loads(marker.read_text(encoding="utf-8"))["files"],
            _time(marker.stat()),
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}, 0
    return (listed, written) if isinstance(listed, dict) else ({}, 0)


def _entries(folder: Path) -> dict[str, tuple[int | None, int | None]]:
    """Everything in the folder by its path inside: (size [bytes], time [ns]) of files, (None, None)
    for folders.
    """
    entries = {}
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(place, name)
            with suppress(FileNotFoundError):
                state = path.lstat()
                known = (
                    (None, None)
                    if stat.S_ISDIR(state.st_mode)
                    else (state.st_size, _time(state))
                )
                entries[path.relative_to(folder).as_posix()] = known
    return dict(sorted(entries.items()))


def _time(state: os.stat_result) -> int:
    """When a file was written, renamed or otherwise put where it is [ns]; copying a file's times
    does not hide that.
    """
    return max(state.st_mtime_ns, state.st_ctime_ns)


def _identity(folder: Path) -> tuple[int, int]:
    """Equal for the same folder in which nothing was added or taken away."""
    with suppress(FileNotFoundError):
        state = folder.stat()
        return state.st_ino, state.st_ctime_ns
    return 0, 0


def _write_marker(folder: Path) -> None:
    """List what the finished folder holds, whole or not at all: a folder with a marker is whole."""
    sizes = {
        name: size for name, (size, _) in _entries(folder).items() if name != MARKER
    }
    content = json.dumps({"files": sizes}, indent=1) + "\n"
    draft = folder / f"{MARKER}-draft"
    draft.write_text(content, encoding="utf-8")
    os.replace(draft, folder / MARKER)


def _move_into_place(partial: Path, final: Path, overwrite: bool) -> None:
    """Give the finished folder its name; what had that name is then called `partial`."""
    for attempt in range(20):
        try:
            _write_marker(partial)
            check_replaceable(final, overwrite)
            if final.exists():
                _exchange(partial, final)
            else:
                os.rename(partial, final)
            return
        except (InputError, OSError) as error:
            again = isinstance(error, OSError) and attempt < 19 and partial.exists()
            if (
                not again
            ):  # else another run to the same place was in the middle of its own step
                raise RunError(f"{error}{_kept(partial, final)}") from None
            time.sleep(0.01 * attempt)


def _kept(partial: Path, final: Path) -> str:
    """Put the finished folder where nobody removes it, and say where."""
    kept = final.with_name(f"{final.name}-finished-{secrets.token_hex(4)}")
    try:
        os.rename(partial, kept)
    except OSError:
        return f" The results are lost: another program took {partial} away."
    return f" The finished results are in {kept}."


def _exchange(new: Path, old: Path) -> None:
    """Swap the names of two existing folders on one file system.

    One step on Linux and macOS. Elsewhere, or on a file system that cannot, three renames: between
    them, for an instant, nothing carries the name `old`, but both folders are whole; see `_clear`
    for a kill in that instant.
    """
    if not _exchange_in_one_step(os.fsencode(new), os.fsencode(old)):
        os.rename(old, _aside(new))
        try:
            os.rename(new, old)
        except OSError:
            os.rename(_aside(new), old)
            raise
        os.rename(_aside(new), new)


def _aside(partial: Path) -> Path:
    """Where an old folder waits while the new one takes its name."""
    return partial.with_name(f"{partial.name}-old")


def _exchange_in_one_step(new: bytes, old: bytes) -> bool:
    """Swap two names; False where the system or the file system cannot. Raises OSError for any
    other failure.
    """
    if not sys.platform.startswith(("linux", "darwin")):
        return False
    library = ctypes.CDLL(None, use_errno=True)
    try:
        if sys.platform == "darwin":
            failed = library.renamex_np(new, old, _RENAME_SWAP)
        else:
            failed = library.renameat2(_AT_FDCWD, new, _AT_FDCWD, old, _RENAME_EXCHANGE)
    except AttributeError:  # a C library without the call
        return False
    reason = ctypes.get_errno()
    if failed and reason not in (
        errno.EINVAL,
        errno.ENOSYS,
        errno.ENOTSUP,
        errno.EOPNOTSUPP,
    ):
        raise OSError(
            reason, os.strerror(reason), os.fsdecode(new), None, os.fsdecode(old)
        )
    return not failed


@contextmanager
def _claimed(final: Path, stem: str, suffix: str = "") -> Iterator[Path]:
    """Yield a free hidden name beside `final` that no other process uses; what has that name
    afterwards is removed.
    """
    remove_abandoned(final, stem, suffix)
    for attempt in range(10):
        partial = final.with_name(f".{stem}.partial-{secrets.token_hex(4)}{suffix}")
        lock = _lock_of(partial)
        with lock.open("x") as file:
            if not _locked(file, lock):
                lock.unlink(
                    missing_ok=True
                )  # without a lock, others must not take it for left over
                if fcntl is not None and attempt < 9:
                    continue  # another process was about to remove it
            try:
                yield partial
            finally:
                _clear(partial, final)
                lock.unlink(missing_ok=True)
            return


def _lock_of(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}.lock")


def remove_abandoned(final: Path, stem: str, suffix: str = "") -> None:
    """Delete what killed writers of `final`, a file STEM.SUFFIX or a folder STEM, left beside
    it.
    """
    if fcntl is None:
        return
    pattern = re.compile(
        rf"(\.{re.escape(stem)}\.partial-[0-9a-f]{{8}}{re.escape(suffix)})\.lock"
    )
    found = []
    with suppress(PermissionError), os.scandir(final.parent) as entries:
        found = [
            match[1] for entry in entries if (match := pattern.fullmatch(entry.name))
        ]
    for partial in map(final.with_name, found):
        lock = _lock_of(partial)
        with (
            suppress(OSError),
            lock.open("r+") as file,
        ):  # removed meanwhile, or not ours to touch
            if _locked(file, lock):
                _clear(partial, final)
                lock.unlink(missing_ok=True)


def _locked(file: IO, path: Path) -> bool:
    """Take the lock of an open lock file; False where a living process holds it, or the file system
    has no locks.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.path.samestat(
            os.fstat(file.fileno()), path.stat()
        )  # else it was removed meanwhile
    except OSError:
        return False


def _clear(partial: Path, final: Path) -> None:
    """Remove what an unfinished or finished step left, but never the last whole result.

    A folder with a marker is whole. One can be left while nothing has the final name, where a
    process was killed in the instant that `_exchange` speaks of: it gets that name.
    """
    for path in (partial, _aside(partial)):
        with suppress(OSError):
            if (path / MARKER).is_file():
                if not final.exists():
                    os.rename(path, final)
                    continue
                (path / MARKER).unlink()  # first: what is half removed is not whole
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
