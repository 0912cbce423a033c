"""Bring pictures that were edited elsewhere."""

from dataclasses import replace
from pathlib import Path

import torch
from pydantic import Field

from edit3r import reporting
from edit3r.config import Settings
from edit3r.errors import InputError, SettingsError
from edit3r.interfaces import Editor
from edit3r.io.images import find_photos
from edit3r.types import EditRequest, Views
from edit3r_editors.pictures import read_picture, view_names


class FolderEditor(Editor):
    """Replaces each view by the picture of its name in a folder, or by natural order when no name fits."""

    class Settings(Settings):
        path: str = Field("", description="folder with one edited picture per view, named as the photos are")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        if len(views.images) != 1:
            raise InputError(f"editor 'folder' holds the pictures of one scene, got a batch of {len(views.images)}.")
        if request.prompt.strip():
            reporting.warn("editor 'folder' does not read the prompt: the pictures in the folder are the edit.")
        names = view_names(views)
        files = match_pictures(_pictures(self.settings.path), names)
        reporting.note("editor.files", [str(file) for file in files])
        images = [read_picture(file, image, name) for file, image, name in zip(files, views.images[0], names)]
        return replace(views, images=torch.stack(images)[None])


def match_pictures(files: list[Path], names: list[str]) -> list[Path]:
    """One of `files` (in natural order) per view: by stem if any stem fits, else in order if the numbers agree."""
    by_stem: dict[str, list[Path]] = {}
    for file in files:
        by_stem.setdefault(file.stem.lower(), []).append(file)
    missing = [name for name in names if name.lower() not in by_stem]
    if not missing:
        return [_only(by_stem[name.lower()]) for name in names]
    found = ", ".join(file.name for file in files)
    if len(missing) < len(names):
        raise InputError(
            f"editor.path: no picture for {', '.join(repr(name) for name in missing)}; found {found}. "
            f"Each view needs a picture of its name, or none of them, for matching in order."
        )
    if len(files) != len(names):
        raise InputError(
            f"editor.path: no file is named like a view ({', '.join(names)}) and {len(files)} pictures cannot be "
            f"matched to {len(names)} views in order; found {found}."
        )
    pairs = ", ".join(f"{name} <- {file.name}" for name, file in zip(names, files))
    reporting.warn(f"editor.path: no file is named like a view, so they are matched in order: {pairs}.")
    return files


def _only(files: list[Path]) -> Path:
    if len(files) > 1:
        listed = ", ".join(sorted(file.name for file in files))
        raise InputError(f"editor.path: {listed} all fit one view; keep one of them.")
    return files[0]


def _pictures(path: str) -> list[Path]:
    if not path:
        raise SettingsError("editor.path: the editor 'folder' needs a folder, for example --set editor.path=edited/.")
    folder = Path(path).expanduser()
    if not folder.is_dir():
        raise InputError(f"editor.path: {path!r} is not a folder.")
    return find_photos(folder)
