"""Files and folders that appear whole or not at all.

The method: what is written to `NAME` is first written into a hidden workspace beside it, a folder
`.NAME.partial-XXXXXXXX`, under the same name. When it is whole, one rename moves it into place.
After a kill at any moment `NAME` is the old result or the new one, never half of one.

A kill can leave the workspace behind. In each workspace lies a file `edit3r.lock`. Its writer holds
the lock of this file (flock), which the operating system releases when that process ends. So a
workspace that can be locked is abandoned, and the next writer to the same place removes it.
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
from typing import Literal

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.files.text import read_plain

try:
    import fcntl
except ImportError:  # Windows: no locks, and abandoned workspaces stay
    fcntl = None  # type: ignore[assignment]

__all__ = [
    "MARKER",
    "atomic_folder",
    "atomic_write",
    "check_apart",
    "check_new_file",
    "check_replaceable",
    "remove_abandoned",
    "sha256_of",
    "write_between",
]

MARKER = ".edit3r-run"
"""File in every finished folder that lists what is in it.

Only a folder that holds just that is replaced without being asked to.
"""

_LOCK = "edit3r.lock"  # in every workspace; what has none is not ours
_MAX_ATTEMPTS = 20  # to move a folder to a place where other runs write too
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2  # linux/fs.h
_RENAME_SWAP = 2  # macOS sys/stdio.h
_CANNOT_SWAP = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file of the same name that replaces `path` when the block ends well.

    It vanishes when the block raises. Raises InputError when the folder does not exist or cannot be
    written to.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(
            f"{path}: cannot be written, there is no folder {path.parent}."
        )
    if path.is_dir():
        raise InputError(f"{path}: cannot be written, it is a folder.")
    with ExitStack() as stack:
        try:
            partial = stack.enter_context(_workspace(path)) / path.name
        except (PermissionError, FileNotFoundError):  # /proc says the second
            raise InputError(f"{path}: no permission to write there.") from None
        partial.touch()
        mode = partial.stat().st_mode
        yield partial
        partial.chmod(mode)  # safetensors makes files that only their owner can read
        try:
            os.replace(partial, path)
        except PermissionError:
            raise InputError(f"{path}: no permission to replace it.") from None


@contextmanager
def atomic_folder(out: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` when the block ends well.

    It vanishes when the block raises. `out` may be new, empty, or an earlier run, which is then
    replaced in one step. An earlier run in which something was added or changed by hand is replaced
    only with `overwrite`. Anything else is refused at once (InputError), so that nobody's files are
    lost and no minutes are spent before saying so.
    """
    final = _resolved(out)
    _check_link(Path(out), overwrite)
    check_replaceable(final, overwrite)
    with ExitStack() as stack:
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            partial = stack.enter_context(_workspace(final)) / final.name
            partial.mkdir()
        except OSError as error:
            raise InputError(
                f"{final}: cannot be created ({error.strerror}); give --out another folder."
            ) from None
        yield partial
        try:
            _write_marker(partial)
            _move_into_place(partial, final, overwrite)
        except (InputError, OSError) as error:
            raise RunError(f"{error}{_keep(partial, final)}") from None


def check_new_file(
    path: str | Path, overwrite: bool, source: Path | None = None
) -> None:
    """Check that a file may be written to `path`.

    Raises InputError where one is there and `overwrite` is not given, and always where it is or
    holds the `source`.
    """
    path = Path(path)
    _check_link(path, overwrite)
    if not path.exists():
        return
    if source is not None:
        check_apart(path, source)
    if not overwrite:
        raise InputError(
            f"{path}: is already there; give another --out, or --overwrite."
        )


def _check_link(out: Path, overwrite: bool) -> None:
    """Raise InputError for a link that somebody may have laid where nobody looks: to what is not
    there, or to a run that would be replaced.
    """
    if not out.is_symlink():
        return
    if not out.exists():
        raise InputError(
            f"{out}: a link to what is not there ({os.readlink(out)}); remove it, or give another "
            "--out."
        )
    if (out / MARKER).is_file() and not overwrite:
        raise InputError(
            f"{out}: a link to the run in {out.resolve()}; give another --out, or --overwrite to "
            "replace that run."
        )


def check_apart(out: str | Path, *sources: Path) -> None:
    """Raise InputError where `out`, which will be replaced, is or holds one of the `sources`."""
    final = _resolved(out)
    for source in sources:
        # What is no path is told by whoever reads it.
        with suppress(OSError, ValueError, RuntimeError):
            source = source.resolve()
        if final in (source, *source.parents):
            raise InputError(
                f"{out}: is or holds the file that is read; give another --out."
            )


def check_replaceable(out: Path, overwrite: bool = False) -> None:
    """Raise InputError unless a run may write to `out`.

    It may be new, empty, an earlier run, or with `overwrite` an earlier run that was changed.
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
            "another folder, or --overwrite to replace it all."
        )
    if changed:
        raise InputError(
            f"{out}: holds files that are not from an earlier run (such as {changed[0]}); give "
            "--out another folder."
        )


def remove_abandoned(final: Path) -> None:
    """Delete the workspaces that killed writers of `final` left, and nothing else."""
    if fcntl is None:
        return
    pattern = re.compile(rf"\.{re.escape(final.name)}\.partial-[0-9a-f]{{8}}")
    with suppress(PermissionError):
        for name in filter(pattern.fullmatch, os.listdir(final.parent)):
            workspace = final.with_name(name)
            with suppress(OSError):
                workspace.rmdir()  # works only on an empty one: killed before it had a lock
            with suppress(OSError), _locked(workspace, "r+"):
                _clear(workspace, final)


def write_between(page: Path, start: str, end: str, text: str) -> None:
    """Replace what stands between the lines `start` and `end` of a text file.

    For pages that are written by hand but for one part, such as a measured table in the
    documentation. Raises InputError where the file lacks the lines.
    """
    before = page.read_text(encoding="utf-8")
    block = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
    if not block.search(before):
        raise InputError(
            f"{page}: has no lines {start!r} and {end!r} to write between."
        )
    after = block.sub(lambda _: f"{start}\n{text}{end}", before)
    with atomic_write(page) as partial:
        partial.write_text(after, encoding="utf-8")


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file of any size."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 22):
            digest.update(block)
    return digest.hexdigest()


def _resolved(out: str | Path) -> Path:
    try:
        final = Path(out).expanduser().resolve()
        final.exists()
    except (OSError, ValueError, RuntimeError) as error:
        # Too long, a null byte, links in a circle, no home.
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{str(out)[:200]!r}: cannot be a folder ({reason}); give --out another one."
        ) from None
    return final


# The workspace


@contextmanager
def _workspace(final: Path) -> Iterator[Path]:
    """Yield a new hidden folder beside `final`, locked in the block and removed after it."""
    remove_abandoned(final)
    with ExitStack() as stack:
        while True:
            workspace = final.with_name(f".{final.name}.partial-{secrets.token_hex(4)}")
            workspace.mkdir()
            try:
                stack.enter_context(_locked(workspace, "x"))
                break
            except (BlockingIOError, FileNotFoundError):
                continue  # before it was locked, another process took it for abandoned
        try:
            yield workspace
        finally:
            _clear(workspace, final)


@contextmanager
def _locked(workspace: Path, mode: Literal["x", "r+"]) -> Iterator[None]:
    """Hold the lock of a workspace, whose file is made with mode "x".

    Raises OSError where another process holds the lock or has removed it. A file system without
    locks is no error for the writer ("x"): nobody else can lock its workspace either.
    """
    if fcntl is None:
        yield
        return
    path = workspace / _LOCK
    with path.open(mode) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if mode == "r+" or isinstance(error, BlockingIOError):
                raise
        path.stat()  # raises where it was removed before it was locked
        yield


def _clear(workspace: Path, final: Path) -> None:
    """Remove a workspace, but never the last whole result.

    A folder with a marker is whole. A kill between the renames of `_swap` leaves whole folders in
    the workspace while nothing is called `final`: the first of them gets that name.
    """
    new = workspace / final.name
    for path in (new, _aside(new)):
        with suppress(OSError):
            if final.exists():
                (path / MARKER).unlink()  # first: what is half removed is not whole
            elif (path / MARKER).is_file():
                os.rename(path, final)
    with suppress(OSError):
        for path in workspace.iterdir():
            if path.name != _LOCK:
                shutil.rmtree(path, ignore_errors=True)
                path.unlink(missing_ok=True)
        (workspace / _LOCK).unlink(missing_ok=True)
        workspace.rmdir()


# Moving a finished folder into place


def _move_into_place(new: Path, final: Path, overwrite: bool) -> None:
    """Give the finished folder its name; an earlier run of that name goes into the workspace."""
    for attempt in range(_MAX_ATTEMPTS):
        check_replaceable(final, overwrite)
        try:
            if final.exists():
                _swap(new, final)
            else:
                os.rename(new, final)
            return
        except OSError:
            # Another run to the same place may be in the middle of its own step.
            if attempt == _MAX_ATTEMPTS - 1 or not new.exists():
                raise
            time.sleep(0.01 * attempt)


def _keep(new: Path, final: Path) -> str:
    """Put the finished folder where nobody removes it, and say where."""
    kept = final.with_name(f"{final.name}-finished-{secrets.token_hex(4)}")
    try:
        os.rename(new, kept)
    except OSError:
        return f" The results are lost: another program took {new} away."
    return f" The finished results are in {kept}."


def _swap(new: Path, final: Path) -> None:
    """Swap the names of two folders.

    One step on Linux and macOS. Elsewhere, or on a file system that cannot, it takes renames:
    between them, for an instant, nothing is called `final`, but both folders are whole. See
    `_clear` for a kill in that instant.
    """
    if _swap_in_one_step(os.fsencode(new), os.fsencode(final)):
        return
    os.rename(final, _aside(new))
    try:
        os.rename(new, final)
    except OSError:
        os.rename(_aside(new), final)
        raise


def _aside(new: Path) -> Path:
    """Where the earlier result waits while the new one takes its name."""
    return new.with_name(f"{new.name}.old")


def _swap_in_one_step(new: bytes, final: bytes) -> bool:
    """Swap two names; False where the system or the file system cannot.

    Raises OSError for any other failure.
    """
    if not sys.platform.startswith(("linux", "darwin")):
        return False
    library = ctypes.CDLL(None, use_errno=True)
    try:
        if sys.platform == "darwin":
            failed = library.renamex_np(new, final, _RENAME_SWAP)
        else:
            failed = library.renameat2(
                _AT_FDCWD, new, _AT_FDCWD, final, _RENAME_EXCHANGE
            )
    except AttributeError:  # a C library without the call
        return False
    reason = ctypes.get_errno()
    if failed and reason not in _CANNOT_SWAP:
        raise OSError(reason, os.strerror(reason), os.fsdecode(final))
    return not failed


# What a finished folder holds


def _write_marker(folder: Path) -> None:
    """List what the finished folder holds, whole or not at all."""
    sizes = {name: _size(state) for name, state in _entries(folder).items()}
    content = json.dumps({"files": sizes}, indent=1) + "\n"
    draft = folder / f"{MARKER}-draft"
    draft.write_text(content, encoding="utf-8")
    os.replace(draft, folder / MARKER)


def _changed(folder: Path) -> list[str]:
    """Names in the folder that its marker does not list, or that changed after it was written."""
    for _ in range(100):
        before = _identity(folder)
        listed, written = _read_marker(folder)
        entries = _entries(folder)
        if _identity(folder) == before:
            break  # else another run has replaced the folder meanwhile
    return [
        name
        for name, state in entries.items()
        if listed.get(name, "") != _size(state)
        or (_size(state) is not None and _time(state) > written)
    ]


def _read_marker(folder: Path) -> tuple[dict[str, int | None], int]:
    """What the marker lists and when it was written [ns]; nothing without a readable marker."""
    marker = folder / MARKER
    try:
        listed = json.loads(read_plain(marker))["files"]
        written = _time(marker.stat())
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}, 0
    return (listed, written) if isinstance(listed, dict) else ({}, 0)


def _entries(folder: Path) -> dict[str, os.stat_result]:
    """All files and folders inside but the marker, by their path in the folder."""
    entries = {}
    for place, folders, files in os.walk(folder):
        for name in folders + files:
            path = Path(place, name)
            with suppress(FileNotFoundError):
                entries[path.relative_to(folder).as_posix()] = path.lstat()
    entries.pop(MARKER, None)
    return dict(sorted(entries.items()))


def _size(state: os.stat_result) -> int | None:
    """Size of a file [bytes]; None for a folder."""
    return None if stat.S_ISDIR(state.st_mode) else state.st_size


def _time(state: os.stat_result) -> int:
    """When a file was written or put where it is [ns]; copied file times do not hide that."""
    return max(state.st_mtime_ns, state.st_ctime_ns)


def _identity(folder: Path) -> tuple[int, int]:
    """Equal for the same folder in which nothing was added or taken away."""
    with suppress(FileNotFoundError):
        state = folder.stat()
        return state.st_ino, state.st_ctime_ns
    return 0, 0
