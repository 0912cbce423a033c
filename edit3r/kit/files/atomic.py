"""Files and folders that appear whole or not at all.

The method: what is written to `NAME` is first written into a hidden workspace beside it, a folder
`.NAME.partial-XXXXXXXX`, under the same name. When it is whole, a rename moves it into place. After
a kill `NAME` is the old result or the new one, never half of one.

A kill can leave the workspace behind. In each workspace lies a file `edit3r.lock`, which its writer
holds locked. The operating system releases it when that process ends. So a workspace that can be
locked is abandoned, and the next writer to the same place removes it.
"""

import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.files.names import expanded
from edit3r.kit.files.text import read_json

__all__ = [
    "MARKER",
    "atomic_folder",
    "atomic_write",
    "check_apart",
    "check_new_file",
    "check_replaceable",
    "digest_of",
    "remove_abandoned",
    "scratch_folder",
    "sha256_of",
]

MARKER = ".edit3r-run"
"""File in every finished folder that lists what is in it.

Only a folder that holds just that is replaced without being asked to.
"""

_WORKSPACE = re.compile(r"\.(.+)\.partial-[0-9a-f]{8}", re.DOTALL)
_LOCK = "edit3r.lock"  # in every workspace; what has none is not ours
_MAX_ATTEMPTS = 8  # to move a folder to a place where other runs write too


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
    replaced. An earlier run in which something was added or changed is replaced only with
    `overwrite`. Anything else is refused at once (InputError), so that nobody's files are
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
        raise InputError(f"{path}: already exists; give another --out, or --overwrite.")


def _check_link(out: Path, overwrite: bool) -> None:
    """Raise InputError for a link that somebody may have laid where nobody looks: to what is not
    there, or to a run that would be replaced.
    """
    if not out.is_symlink():
        return
    if not out.exists():
        raise InputError(
            f"{out}: a broken link ({os.readlink(out)}); remove it, or give another "
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
                f"{out}: --out would overwrite a file that is read; give another one."
            )


def check_replaceable(out: Path, overwrite: bool = False) -> None:
    """Raise InputError unless a run may write to `out`.

    It may be new, empty, an earlier run, or with `overwrite` an earlier run that was changed.
    """
    try:
        mode = out.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):  # perhaps another run replaces it
        return
    if not stat.S_ISDIR(mode):
        raise InputError(
            f"{out}: --out must be a folder, but a file of that name exists."
        )
    if os.path.ismount(out):  # Path.is_mount raises where the folder goes meanwhile
        raise InputError(
            f"{out}: a mount point cannot be replaced in one step; give --out a folder inside it."
        )
    is_run = (out / MARKER).is_file()
    try:
        changed = [] if overwrite and is_run else _changed(out)
    except FileNotFoundError:  # another run puts its own there just now
        return
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


def remove_abandoned(*finals: Path) -> None:
    """Delete the workspaces that killed writers of `finals`, all in one folder, left."""
    from filelock import FileLock, Timeout

    names = {final.name: final for final in finals}
    with suppress(PermissionError):
        for name in os.listdir(finals[0].parent):
            workspace_name = _WORKSPACE.fullmatch(name)
            final = names.get(workspace_name[1]) if workspace_name else None
            workspace = finals[0].with_name(name)
            if final is None or workspace.is_symlink():
                continue
            with suppress(OSError):
                workspace.rmdir()  # works only on an empty one: killed before it had a lock
            if (workspace / _LOCK).is_file():
                with (
                    suppress(OSError, Timeout),
                    FileLock(workspace / _LOCK, blocking=False),
                ):
                    _clear(workspace, final)


@contextmanager
def scratch_folder(name: str) -> Iterator[Path]:
    """Yield a new temporary folder, removed after the block; where a kill prevents that, the next
    one of that `name` removes it.
    """
    with _workspace(Path(tempfile.gettempdir(), name).resolve()) as folder:
        yield folder


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file of any size."""
    with path.open("rb") as file:
        return digest_of(file)


def digest_of(file: BinaryIO) -> str:
    """The SHA-256 of what is left to read of an open file."""
    digest = hashlib.sha256()
    while block := file.read(1 << 22):
        digest.update(block)
    return digest.hexdigest()


def _resolved(out: str | Path) -> Path:
    if not str(out).strip():
        raise InputError("--out is empty; give it the name of a folder or file.")
    try:
        final = expanded(out).resolve()
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
    from filelock import FileLock, Timeout

    remove_abandoned(final)
    with ExitStack() as stack:
        while True:
            workspace = final.with_name(f".{final.name}.partial-{secrets.token_hex(4)}")
            workspace.mkdir()
            try:
                stack.enter_context(FileLock(workspace / _LOCK, blocking=False))
                break
            except (Timeout, FileNotFoundError):
                continue  # before it was locked, another process took it for abandoned
        try:
            yield workspace
        finally:
            _clear(workspace, final)


def _clear(workspace: Path, final: Path) -> None:
    """Remove a workspace, but never an earlier result that nothing has taken the place of."""
    old = _aside(workspace / final.name)
    with suppress(OSError):
        if old.exists() and not final.exists():  # nothing took its place
            os.rename(old, final)
        for path in workspace.iterdir():
            if path.name != _LOCK:
                shutil.rmtree(path, ignore_errors=True)
                path.unlink(missing_ok=True)
        (workspace / _LOCK).unlink(missing_ok=True)
        workspace.rmdir()


# Moving a finished folder into place


def _move_into_place(new: Path, final: Path, overwrite: bool) -> None:
    """Give the finished folder its name; an earlier run of that name goes into the workspace, from
    where `_clear` takes it back if the new one did not get the name.
    """
    old = _aside(new)
    for attempt in range(_MAX_ATTEMPTS):
        try:
            check_replaceable(final, overwrite)
            if final.exists():
                shutil.rmtree(old, ignore_errors=True)  # of an attempt before
                os.rename(final, old)
            os.rename(new, final)
            return
        except (InputError, OSError):
            # Another run to the same place may be in the middle of its own step.
            if attempt == _MAX_ATTEMPTS - 1 or not new.exists():
                raise
            time.sleep(0.02 * attempt)


def _aside(new: Path) -> Path:
    """Where the earlier result waits while the new one takes its name."""
    return new.with_name(f"{new.name}.old")


def _keep(new: Path, final: Path) -> str:
    """Put the finished folder where nobody removes it, and say where."""
    rescued = final.with_name(f"{final.name}-finished-{secrets.token_hex(4)}")
    try:
        os.rename(new, rescued)
    except OSError:
        return f" The results are lost: another program took {new} away."
    return f" The finished results are in {rescued}."


# What a finished folder holds


def _write_marker(folder: Path) -> None:
    """List what the finished folder holds."""
    content = json.dumps({"files": _contents(folder)}, indent=1) + "\n"
    (folder / MARKER).write_text(content, encoding="utf-8")


def _changed(folder: Path) -> list[str]:
    """Names in the folder that its marker does not list, or lists with another content."""
    listed = _listed(folder)
    held = _contents(folder)
    return [name for name, hashed in held.items() if listed.get(name, "") != hashed]


def _listed(folder: Path) -> dict[str, str | None]:
    """What the marker lists; nothing without a readable marker."""
    try:
        listed = read_json(folder / MARKER)["files"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return listed if isinstance(listed, dict) else {}


def _contents(folder: Path) -> dict[str, str | None]:
    """All inside but the marker by their path in the folder: the SHA-256 of files, None of folders,
    of links where they lead.
    """
    contents: dict[str, str | None] = {}
    for place, folders, files in os.walk(folder):
        for name in folders + files:
            path = Path(place, name)
            with suppress(FileNotFoundError):
                contents[path.relative_to(folder).as_posix()] = _content(path)
    contents.pop(MARKER, None)
    return dict(sorted(contents.items()))


def _content(path: Path) -> str | None:
    if path.is_symlink():
        target = os.readlink(path)
        return f"link {hashlib.sha256(os.fsencode(target)).hexdigest()}"
    if path.is_dir():
        return None
    return sha256_of(path) if path.is_file() else "no file"
