"""Results appear whole or not at all: files and folders are written under a temporary name and then moved.

A kill at any moment leaves the old result or the new one under the final name, never half of one. What a killed run
had written stays behind in a hidden folder beside it (`.NAME.partial-...`); the next run to the same place removes it.
"""

import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from edit3r.errors import InputError, RunError
from edit3r.io.exchange import exchange
from edit3r.io.unfinished import remove_abandoned, unfinished_name, writing

MARKER = ".edit3r-run"
"""In every finished run folder: the list of its files. Only a folder that holds nothing else is ever replaced."""


@dataclass(frozen=True)
class RunFolder:
    """Where each result of a run lies inside its folder."""

    root: Path

    @property
    def scene(self) -> Path:
        """The edited 3D Gaussians."""
        return self.root / "scene.ply"

    @property
    def inputs(self) -> Path:
        """Folder of the photos as the run used them."""
        return self._folder("inputs")

    @property
    def edited(self) -> Path:
        """Folder of the 2D edits."""
        return self._folder("edited")

    @property
    def renders(self) -> Path:
        """Folder of the pictures of the scene."""
        return self._folder("renders")

    @property
    def before_after(self) -> Path:
        """The sheet of photo, 2D edit and 3D result per view."""
        return self.root / "before_after.png"

    @property
    def video(self) -> Path:
        """The camera path as a video."""
        return self.root / "video.webm"

    @property
    def viewer(self) -> Path:
        """The scene in one page that opens from disk."""
        return self.root / "viewer.html"

    @property
    def cameras(self) -> Path:
        """Intrinsics and poses of the input views."""
        return self.root / "cameras.json"

    @property
    def manifest(self) -> Path:
        """How the run was made."""
        return self.root / "run.json"

    def _folder(self, name: str) -> Path:
        folder = self.root / name
        folder.mkdir(exist_ok=True)
        return folder


@contextmanager
def atomic_folder(out: str | Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` when the block ends well, and vanishes when it raises.

    `out` may be new, empty, or an earlier run, which is then replaced in one step. Anything else is refused at once
    (InputError), so that nobody's files are lost and no minutes are spent before saying so.
    """
    final = Path(out).expanduser().resolve()
    check_replaceable(final)
    remove_abandoned(final)
    partial = _make_partial(final)
    try:
        with writing(partial):
            yield partial
        _list_files(partial)
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
        yield partial
        os.replace(partial, path)
    except PermissionError:
        raise InputError(f"{path}: no permission to write there.") from None
    finally:
        partial.unlink(missing_ok=True)


def _make_partial(final: Path) -> Path:
    partial = unfinished_name(final)
    try:
        partial.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{final}: cannot be created ({error.strerror}); give --out another folder.") from None
    return partial


def _move_into_place(partial: Path, final: Path) -> None:
    try:
        check_replaceable(final)
        if final.exists():
            exchange(partial, final)
            shutil.rmtree(partial, ignore_errors=True)
        else:
            os.rename(partial, final)
    except (InputError, OSError) as error:
        raise RunError(f"{error} The finished results are in {partial}.") from None


def _files(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())


def _list_files(folder: Path) -> None:
    files = [name for name in _files(folder) if name != MARKER]
    (folder / MARKER).write_text(json.dumps({"files": files}, indent=1) + "\n", encoding="utf-8")


def _foreign_files(folder: Path) -> list[str]:
    try:
        listed = json.loads((folder / MARKER).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        listed = []
    known = {MARKER, *(name for name in listed if isinstance(name, str))}
    return [name for name in _files(folder) if name not in known]
