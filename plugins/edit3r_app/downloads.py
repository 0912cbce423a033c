"""What can be taken along from a run; what the run did not write is made when asked for."""

import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edit3r_outputs.api import SavedScene, write_saved

from edit3r import default_registry
from edit3r.contract.component import Offer
from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.scenes.files import scene_file
from edit3r_app.jobs import PREVIEW, JobsFolder

ARCHIVE = "all.zip"
VIEWER = "viewer.html"
EDITED = "edited-photos.zip"  # the 2D edits, also of a run that failed
FILMS = {"flight.mp4": "mp4", "flight.webm": "video"}
"""Of a flight that the user made, and their writers."""
OF_EVERY_RUN = {
    "scene.ply": "3D Gaussians, for most programs",
    "cameras.json": "where the photos were taken from",
    "run.json": "how it was made",
    EDITED: "the edited photos",
    ARCHIVE: "everything in one file",
}
FIRST = (
    "viewer.html",
    "video.mp4",
    "video.webm",
    "before_after.png",
    "scene.ply",
    ARCHIVE,
)
"""What most people want, above all else."""


def offered_files(folder: JobsFolder, run: str) -> list[dict[str, Any]]:
    """Every download of a run: its file, what it is for, what it keeps and loses, and its size, or
    none where it is made when asked for.
    """
    source = folder.path(run)
    found = []
    for what, offer in sorted(_downloads().items(), key=lambda one: _place(one[0])):
        of_all = OF_EVERY_RUN.get(what)
        one = offer.component if offer and not of_all else None
        there = (source / what, folder.beside(run) / what)
        sizes = [path.stat().st_size for path in there if path.is_file()]
        found.append(
            {
                "file": what,
                "what": one.summary if one else of_all,
                "keeps": one.keeps if one else "",
                "loses": one.loses if one else "",
                "bytes": sizes[0] if sizes else None,
                "usual": what in FIRST,
            }
        )
    return found


def _place(what: str) -> tuple[int, str]:
    """Among the downloads: what most want first, in its order, the rest by name."""
    return (FIRST.index(what) if what in FIRST else len(FIRST), what)


def _downloads() -> dict[str, Offer | None]:
    """All files that can be had, with the writers that make them; a folder is sent packed."""
    files: dict[str, Offer | None] = dict.fromkeys(OF_EVERY_RUN)
    registry = default_registry()
    for offer in registry.offers("writer"):
        if not registry.missing(offer):
            packed = ".zip" if offer.component.makes_folder else ""
            files[f"{offer.component.file_name()}{packed}"] = offer
    return files


def prepared(folder: JobsFolder, run: str, what: str) -> Path:
    """The file to download, made where the run did not write it.

    Raises InputError for what is no download, and for what the run left out.
    """
    if what == EDITED:
        return _edited_photos(folder, run)
    source = folder.path(run)
    made = folder.beside(run) / what
    if what in FILMS and _is_file(made):
        return made
    writers = _downloads()
    if what not in writers:
        raise InputError(f"{what[:40]!r}: not a file of a run.")
    for file in (source / what, made):
        if _is_file(file):
            return file
    writer = writers[what]
    if what == ARCHIVE:
        _pack(source, made)
    elif writer is not None and scene_file(str(source)).is_file():
        _write(writer, source, made)
    else:
        raise InputError(f"{run} has no {what}: its settings left it out.")
    return made


def has_edits(folder: JobsFolder, run: str) -> bool:
    """Whether the preview of a run that is not finished holds its 2D edit."""
    return (folder.private / run / PREVIEW / "run.json").is_file()


def _edited_photos(folder: JobsFolder, run: str) -> Path:
    """An archive of the 2D edits: those of the run, or of its preview where it has none."""
    folder.job(run)
    of_run = folder.root / run / "edited"
    source = of_run if of_run.is_dir() else folder.private / run / PREVIEW
    if not of_run.is_dir() and not has_edits(folder, run):
        raise InputError(f"{run} has no edited photos.")
    made = folder.beside(run) / EDITED
    with atomic_write(made) as partial, zipfile.ZipFile(partial, "w") as archive:
        for file in _files(source):
            if file.suffix != ".json":
                archive.write(file, file.name)
    return made


def _is_file(file: Path) -> bool:
    """Whether it is one, and no link: a run may come from a stranger."""
    return file.is_file() and not file.is_symlink()


def _write(offer: Offer, run: Path, made: Path) -> None:
    """Let a writer make the file, or the folder that is then packed."""
    registry = default_registry()
    writer = registry.build("writer", offer.qualified_name)
    saved = SavedScene(scene_file(str(run)), registry)
    if not offer.component.makes_folder:
        write_saved(writer, made, saved)
        return
    folder = made.with_suffix("")
    write_saved(writer, folder, saved)
    _pack(folder, made)


def _pack(run: Path, target: Path) -> None:
    with atomic_write(target) as partial, zipfile.ZipFile(partial, "w") as archive:
        for file in _files(run):
            archive.write(file, Path(run.name) / file.relative_to(run))


def _files(run: Path) -> Iterator[Path]:
    """The files of a run that a person wants, without its cache."""
    for place, folders, names in os.walk(run):
        folders[:] = [name for name in folders if name != "cache"]
        for file in sorted(Path(place, name) for name in names):
            if not file.is_symlink() and not file.name.startswith("."):
                yield file
