"""Folders of photos as scenes: which photos a method is given, and which are held back."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.cameras import CAMERA_FILES, read_cameras
from edit3r.io.images import find_photos, load_photos
from edit3r_measure.evaluation.pairs import choose_triples

__all__ = ["SceneFolder", "find_scenes"]


@dataclass(frozen=True)
class SceneFolder:
    """Photos of one scene."""

    id: str
    path: Path
    cameras: str  # name of the camera file, "" without
    files: tuple[str, ...]  # relative to `path`
    inputs: tuple[int, ...]  # indices of `files`
    held_back: tuple[int, ...]

    def pictures(self, size: int) -> Float[Tensor, "view 3 height width"]:
        """The input photos, longer side `size` [pixels]."""
        return load_photos([self.path / self.files[index] for index in self.inputs], size=size).views.images[0]


def find_scenes(folder: Path, views: int) -> list[SceneFolder]:
    """Every sub-folder with at least two photos, else the folder itself. Raises InputError when there is none.

    Scenes without poses give `views` evenly spaced photos as inputs.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of scenes.")
    places = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    scenes = [scene for path in places if (scene := _scene(path, views)) is not None]
    own = None if scenes else _scene(folder, views)
    if not scenes and own is None:
        raise InputError(f"{folder}: expected folders with at least two photos each.")
    return scenes or [own]


def _scene(path: Path, views: int) -> SceneFolder | None:
    try:
        files = tuple(file.relative_to(path).as_posix() for file in find_photos(path))
    except InputError:  # a folder of something else
        return None
    if len(files) < 2:
        return None
    cameras = next((name for name in CAMERA_FILES if (path / name).is_file()), "")
    inputs, held_back = _split(path, files, cameras, views)
    return SceneFolder(os.path.basename(os.path.abspath(path)), path, cameras, files, inputs, held_back)


def _split(path: Path, files: Sequence[str], cameras: str, views: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Two photos 5 to 30 degrees apart with one held back between them, where poses are known; else evenly spaced."""
    known = read_cameras(path / cameras) if cameras else []
    posed = [camera for camera in known if camera.c2w is not None and camera.file in files]
    triples = choose_triples(posed, 3)
    if triples:
        middle = triples[len(triples) // 2]
        first, second, target = (files.index(posed[i].file) for i in (middle.first, middle.second, middle.target))
        return (first, second), (target,)
    spaced = torch.linspace(0, len(files) - 1, min(views, len(files))).round().long().tolist()
    return tuple(spaced), ()
