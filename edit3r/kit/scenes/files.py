"""Where the file of a saved scene is; SOG that lies in loose files, a `meta.json` and images."""

import re
import zipfile
from pathlib import Path
from typing import Any

from edit3r.contract.errors import InputError
from edit3r.kit.files.names import is_plain_name
from edit3r.kit.files.text import read_json

TRAINED = re.compile(r"iteration_(\d+)")
"""Folders that 3D Gaussian Splatting makes."""


def scene_file(text: str) -> Path:
    """Argument type of a saved scene: its file, or a folder that holds one.

    In a folder that is the `scene.ply` of a run, a scene of another format, or the last one that 3D
    Gaussian Splatting left there.
    """
    path = Path(text)
    if not path.is_dir():
        return path
    usual = [
        path / "scene.ply",
        *sorted(path.glob("scene.*")),
        path / "point_cloud.ply",
    ]
    loose = path / "meta.json"
    endings = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb")
    usual = [one for one in usual if one.suffix.lower() in endings]
    trained = [
        folder / "point_cloud.ply"
        for place in (path, path / "point_cloud")
        for folder in sorted(place.glob("iteration_*"), key=_iteration, reverse=True)
    ]
    there = (one for one in [*usual, *trained] if one.is_file())
    if is_loose_sog(loose):
        return next(there, loose)
    return next(there, path / "scene.ply")


def _iteration(folder: Path) -> int:
    name = TRAINED.fullmatch(folder.name)
    return int(name[1][:9]) if name else -1


LOOSE = "meta.json"
MOST_FILES = 40  # that one names; it has about seven


def is_loose_sog(path: Path) -> bool:
    """Whether the file lists the images of a SOG."""
    return path.name == LOOSE and bool(_files_of(path))


def gathered(path: Path, archive: Path) -> Path:
    """Put a `meta.json` and the images that it names into one archive, as SOG is too."""
    names = _files_of(path)
    for name in names:
        if not is_plain_name(name):
            raise InputError(
                f"{path}: names {name[:60]!r}, which is no file beside it."
            )
        if not path.with_name(name).is_file():
            raise InputError(f"{path}: names {name}, which does not lie beside it.")
    with zipfile.ZipFile(archive, "w") as whole:
        for name in (LOOSE, *names):
            whole.write(path.with_name(name), name)
    return archive


def _files_of(path: Path) -> list[str]:
    """The images that a `meta.json` names; none where it is no SOG."""
    try:
        content = read_json(path)
    except (OSError, ValueError, RecursionError):
        return []
    if not isinstance(content, dict) or "means" not in content:
        return []
    columns: list[Any] = [one for one in content.values() if isinstance(one, dict)]
    listed = (one.get("files") for one in columns)
    named = [name for files in listed if isinstance(files, list) for name in files]
    texts = [name for name in dict.fromkeys(map(str, named))]
    return texts[:MOST_FILES]
