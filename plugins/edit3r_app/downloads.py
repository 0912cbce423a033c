"""What can be taken along from a run; formats that the run did not write are made when asked."""

import os
import zipfile
from collections.abc import Iterator
from pathlib import Path

from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.scenes.export import export_scene
from edit3r.kit.scenes.formats import FORMATS
from edit3r.kit.scenes.ply import load_ply
from edit3r_app.jobs import JobsFolder

ARCHIVE = "all.zip"
DOWNLOADS = {
    "viewer.html": "one page that opens anywhere, to send",
    "scene.ply": "3D Gaussians, for most programs",
    "scene.spz": "small, for phones and web viewers",
    "scene.sog": "smallest, for PlayCanvas and SuperSplat; takes half a minute",
    "scene.splat": "for older web viewers",
    "scene.compressed.ply": "for SuperSplat and PlayCanvas",
    "scene.glb": "glTF, for 3D programs",
    "video.webm": "a flight around the scene",
    "before_after.png": "photo, edit and 3D side by side",
    "cameras.json": "where the photos were taken from",
    "run.json": "how it was made",
    ARCHIVE: "everything in one file",
}


def prepared(folder: JobsFolder, run: str, what: str) -> Path:
    """The file to download, made where the run did not write it.

    Raises InputError for what is no download, and for what the run left out.
    """
    source = folder.path(run)
    if what not in DOWNLOADS:
        raise InputError(f"{what[:40]!r}: not a file of a run.")
    file = source / what
    if file.is_file() and not file.is_symlink():
        return file
    made = folder.beside(run) / what
    forms = [form for form, suffix in FORMATS.items() if what == f"scene{suffix}"]
    if made.is_file():
        return made
    if what == ARCHIVE:
        _pack(source, made)
    elif forms and (source / "scene.ply").is_file():
        scene = load_ply(source / "scene.ply", visible=True)
        export_scene(made, scene, forms[0])
    else:
        raise InputError(f"{run} has no {what}: its settings left it out.")
    return made


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
