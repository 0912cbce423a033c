"""The editor `folder`: images that were edited elsewhere, and how image files become views
again.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

import edit3r
from edit3r.contract import reporting
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Editor
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.files.names import expanded
from edit3r.kit.photos.framing import frame_for
from edit3r.kit.photos.images import find_photos, read_image, to_bytes
from edit3r.kit.photos.masks import photo_named

# The numbers of this block: no figures kept.
LEAST_CROPPED = 0.01  # share of a picture whose loss is said
COMPARED = 64  # sides of the copies of picture and photo that are compared [pixels]
LEAST_LIKENESS = 0.6  # of what lies on its photo; parts of one reach 0.53
CLEARLY = 0.1  # how much more alike a squashed or turned picture must be
MOST_ENLARGED = 2.0  # times, of a model that is smaller than its photos


class FolderEditor(Editor):
    """Replaces each view by the image of its name in a folder, else in natural order."""

    class Settings(edit3r.Settings):
        path: str = ""
        """folder with one edited picture per view, named as the photos are"""

    settings: Settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        if len(views.images) != 1:
            raise InputError(
                "editor 'folder' holds the pictures of one scene, got a batch of "
                f"{len(views.images)}."
            )
        if request.prompt.strip():
            reporting.warn(
                "editor 'folder' does not read the prompt: the pictures in the folder are the edit."
            )
        names = view_names(views)
        files = match_files(_images_in(self.settings.path), names)
        reporting.note("editor.files", [str(file) for file in files])
        images = [
            read_edit(file, image, name)
            for file, image, name in zip(files, views.images[0], names)
        ]
        return replace(views, images=torch.stack(images)[None])


def match_files(files: list[Path], names: list[str]) -> list[Path]:
    """Choose one of `files` (in natural order) per view: by stem if any stem fits, else by names
    that hold the view's, such as `left (edited).png`, else in order if as many.
    """
    by_stem: dict[str, list[Path]] = {}
    for file in files:
        by_stem.setdefault(file.stem.lower(), []).append(file)
    missing = [name for name in names if name.lower() not in by_stem]
    if not missing:
        return [_only(by_stem[name.lower()]) for name in names]
    found = ", ".join(file.name for file in files)
    if len(missing) < len(names):
        raise InputError(
            f"editor.path: no picture for {', '.join(repr(name) for name in missing)}; found "
            f"{found}. "
            f"Each view needs a picture of its name, or none of them, for matching in order."
        )
    named = [photo_named(file.stem, [(name,) for name in names]) for file in files]
    if sorted(view for view in named if view is not None) == [*range(len(names))]:
        return [files[named.index(view)] for view in range(len(names))]
    if len(files) != len(names):
        raise InputError(
            f"editor.path: no file is named like a view ({', '.join(names)}) and {len(files)} "
            f"pictures cannot be matched to {len(names)} views in order; found {found}."
        )
    pairs = ", ".join(f"{name} <- {file.name}" for name, file in zip(names, files))
    reporting.warn(
        f"editor.path: no file is named like a view, so they are matched in order: {pairs}."
    )
    return files


def _only(files: list[Path]) -> Path:
    if len(files) > 1:
        listed = ", ".join(sorted(file.name for file in files))
        raise InputError(f"editor.path: {listed} all fit one view; keep one of them.")
    return files[0]


def _images_in(path: str) -> list[Path]:
    if not path:
        raise SettingsError(
            "editor.path: the editor 'folder' needs a folder, for example --set "
            "editor.path=edited/."
        )
    folder = expanded(path)
    if not folder.is_dir():
        raise InputError(f"editor.path: {path!r} is not a folder.")
    return find_photos(folder)


def view_names(views: Views) -> list[str]:
    """A distinct file stem for every view: its name where it has one, else `view_1` and on."""
    if not views.names:
        return [f"view_{index + 1}" for index in range(views.count)]
    stems = [Path(name).stem for name in views.names]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{stem}_{index + 1}" for index, stem in enumerate(stems)]


def read_edit(
    path: Path, like: Float[Tensor, "3 height width"], name: str
) -> Float[Tensor, "3 height width"]:
    """Read the edit of view `name` from an image file, at the size, dtype and device of `like`.

    Another size is framed as photos are when they are loaded: scaled to cover, cropped around the
    middle. So an edit of the original photo lands where the photo did. One of another shape that
    lies on the photo when it is squashed, as image models return squares, or turned, as programs
    leave what EXIF told to turn, is squashed or turned.
    """
    image = read_image(path)
    height, width = like.shape[-2:]
    frame = frame_for((image.height, image.width), (height, width))
    cut, done = frame.cut(image), []
    if frame.cropped > LEAST_CROPPED:
        cut, how = _as_it_lies(image, cut, Image.fromarray(to_bytes(like)))
        if how:
            done.append(f"it is {how} to lie on its photo")
        else:
            done.append(
                f"of it {frame.cropped:.0%} is cropped away. Right for an edit of the whole photo "
                "if that was cropped too"
            )
    if frame.scale > MOST_ENLARGED:
        done.append(f"it is enlarged {frame.scale:.1f} times, and not sharp")
    if done:
        reporting.warn(
            f"{path.name} is {image.width}x{image.height} but view {name!r} is {width}x{height}: "
            f"{'; '.join(done)}."
        )
    pixels = np.array(cut, dtype=np.float32) / 255
    return torch.from_numpy(pixels).permute(2, 0, 1).to(like)


def _as_it_lies(
    image: Image.Image, cut: Image.Image, photo: Image.Image
) -> tuple[Image.Image, str]:
    """The picture squashed or turned where that clearly lies on the photo, and how; else as cut."""
    turned = {-90: Image.Transpose.ROTATE_270, 90: Image.Transpose.ROTATE_90}
    ways = {"squashed": image}
    for angle, turn in turned.items():
        ways[f"turned by {angle} degrees"] = image.transpose(turn)
    best, how, likeness = cut, "", _likeness(cut, photo) + CLEARLY
    for way, picture in ways.items():
        tried = picture.resize(photo.size, Image.Resampling.LANCZOS)
        if _likeness(tried, photo) > max(LEAST_LIKENESS, likeness):
            best, how, likeness = tried, way, _likeness(tried, photo)
    return best, how


def _likeness(one: Image.Image, other: Image.Image) -> float:
    """Correlation of the edges of two pictures, whatever their colours; 0 where one has none."""
    edges = [_edges(picture) for picture in (one, other)]
    if min(float(each.std()) for each in edges) == 0:
        return 0.0
    return float(np.corrcoef(edges[0], edges[1])[0, 1])


def _edges(picture: Image.Image) -> Float[np.ndarray, " pixel"]:
    small = picture.convert("L").resize((COMPARED, COMPARED), Image.Resampling.BOX)
    down, across = np.gradient(np.asarray(small, np.float32))
    return np.hypot(down, across).ravel()
