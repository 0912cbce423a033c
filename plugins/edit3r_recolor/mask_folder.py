"""Object masks as files: what `edit3r recolor` writes, and what data sets bring along.

Either a folder per object (`masks/1/NAME.png`, white inside, greys at soft edges; a photo without a file does not show
the object), or one picture per photo (`masks/NAME.png`) whose values are object numbers, 0 being none. NAME is the
photo's name without suffix.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.images import Photo
from edit3r.io.masks import fitted_mask, read_mask

MOST_LABELS = 1000
"""A picture with more values than this is a photo or a soft mask, not a map of object numbers."""


def write_masks(folder: Path, names: list[str], numbers: list[int], masks: Float[Tensor, "object view h w"]) -> None:
    """One folder per object, named by its number; views that do not show it get no file."""
    for number, of_object in zip(numbers, masks):
        own = folder / str(number)
        own.mkdir(parents=True, exist_ok=True)
        for name, mask in zip(names, of_object):
            if mask.any():
                Image.fromarray((mask * 255).round().to(torch.uint8).cpu().numpy()).save(own / f"{name}.png")


def read_masks(folder: Path, photos: tuple[Photo, ...]) -> Float[Tensor, "object view height width"]:
    """Masks of every object in every photo, in [0, 1], on the photos' views. Raises InputError when there are none."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of masks.")
    objects = sorted((p for p in folder.iterdir() if p.is_dir()), key=_by_number)
    masks = [_one_object(own, photos) for own in objects] if objects else _label_maps(folder, photos)
    masks = [mask for mask in masks if mask.any()]
    if not masks:
        raise InputError(
            f"{folder}: no masks for these photos; expected a folder per object with files such as "
            f"{photos[0].name}.png, or {photos[0].name}.png itself with object numbers."
        )
    return torch.stack(masks)


def read_masks_of(
    folder: Path, photos: tuple[Photo, ...], numbers: list[int]
) -> Float[Tensor, "object view height width"]:
    """Masks of the objects with these numbers, as `write_masks` left them."""
    for number in numbers:
        if not (folder / str(number)).is_dir():
            raise InputError(f"{folder}: lacks the folder {number} with that object's masks.")
    return torch.stack([_one_object(folder / str(number), photos) for number in numbers])


def _by_number(path: Path) -> tuple:
    return (0, int(path.name), "") if path.name.isdecimal() else (1, 0, path.name)


def _one_object(folder: Path, photos: tuple[Photo, ...]) -> Float[Tensor, "view height width"]:
    masks = []
    for photo in photos:
        file = _file_of(folder, photo)
        masks.append(torch.zeros(photo.frame.target) if file is None else read_mask(file, photo.frame))
    return torch.stack(masks)


def _file_of(folder: Path, photo: Photo) -> Path | None:
    found = sorted(p for p in folder.iterdir() if p.is_file() and p.stem == photo.name)
    return found[0] if found else None


def _label_maps(folder: Path, photos: tuple[Photo, ...]) -> list[Float[Tensor, "view height width"]]:
    files = [_file_of(folder, photo) for photo in photos]
    maps = [None if file is None else _label_map(file) for file in files]
    numbers = sorted({int(n) for labels in maps if labels is not None for n in np.unique(labels)} - {0})
    if len(numbers) > MOST_LABELS:
        raise InputError(f"{folder}: {len(numbers)} different values; expected object numbers, or a folder per object.")
    objects = []
    for number in numbers:
        views = [
            torch.zeros(photo.frame.target)
            if labels is None
            else fitted_mask(Image.fromarray(((labels == number) * 255).astype(np.uint8)), photo.frame, file)
            for photo, labels, file in zip(photos, maps, files)
        ]
        objects.append(torch.stack(views))
    return objects


def _label_map(file: Path) -> np.ndarray:
    """Object numbers as stored: grey levels, palette indices or 16-bit values."""
    try:
        with Image.open(file) as picture:
            values = np.array(picture)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as a mask ({error}).") from None
    if values.ndim != 2:
        raise InputError(f"{file}: a colour picture; expected object numbers as grey levels or palette indices.")
    return values.astype(np.int64)
