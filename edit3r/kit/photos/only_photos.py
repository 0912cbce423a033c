"""What among image files is not a photo of the scene: masks, our own sheets, and photos twice.

Pictures tell, not words in names: a file that is named after another one is a mask or a map where
it is grey, of few colours or see-through beside a photo in colour. Two files of one name are one
photo in two formats where they show the same.
"""

from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

import numpy as np
from PIL.Image import Image

from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.reporting import say
from edit3r.kit.photos.decode import decode, image_size, read_header

# The numbers of this block: no figures kept.
MADE_HERE = "edit3r, no photo"
"""What sheets, previews and masks of ours carry as their software."""
_LIKE = 0.95  # correlation of small copies of one photo in two formats
_SMALL = (32, 32)  # their size [pixels]
_GREY = 6.0  # most that the channels of a grey picture differ, in the mean [levels]
_LABELS = 64  # most colours of a picture of labels


def only_photos(files: Sequence[Path]) -> list[Path]:
    """The files without masks, sheets of ours and photos twice; says what was left out."""
    left_out = {file for file in files if _made_here(file)}
    photos = [file for file in files if file not in left_out]
    for one, other in permutations(photos, 2):
        if _is_map_of(one, other) or _is_copy_of(one, other):
            left_out.add(one)
    kept = [file for file in files if file not in left_out]
    if not kept or not left_out:
        return list(files)
    names = [file.name for file in files if file in left_out]
    listed = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
    say(
        "photos.left_out",
        f"{listed}: no photo of its own (a mask, a sheet, or a photo twice)",
    )
    return kept


def _made_here(file: Path) -> bool:
    """Whether the file says of itself that it was made here."""
    try:
        return read_header(file).software == MADE_HERE
    except (InputError, MissingDependencyError):  # told where it is read
        return False


def _says_more(name: str, stem: str) -> bool:
    """Whether a name begins or ends with another one, and goes on; img10 is not after img1."""
    if len(name) <= len(stem):
        return False
    begins = name.startswith(stem) and not name[len(stem)].isalnum()
    return begins or (name.endswith(stem) and not name[-len(stem) - 1].isalnum())


def _order(file: Path) -> tuple[int, str]:
    """By which the original comes before the other formats of it: the one with most pixels."""
    try:
        height, width = image_size(file)
    except (InputError, MissingDependencyError):
        return 0, file.suffix
    return -height * width, file.suffix


def _is_map_of(file: Path, other: Path) -> bool:
    """Whether a see-through, grey or few-coloured picture is named after a photo in colour."""
    name, stem = (one.stem.casefold() for one in (file, other))
    if name != stem and not _says_more(name, stem):
        return False
    try:
        mask, photo = (decode(one, 8 * _SMALL[0]) for one in (file, other))
    except (InputError, MissingDependencyError):
        return False
    if photo.alpha is not None or _is_grey(photo.pixels):
        return False
    few = mask.pixels.getcolors(_LABELS) is not None
    return mask.alpha is not None or few or _is_grey(mask.pixels)


def _is_grey(pixels: Image) -> bool:
    values = np.asarray(pixels, np.int16)
    return float(np.ptp(values, axis=2).mean()) < _GREY


def _is_copy_of(file: Path, other: Path) -> bool:
    """Whether a file surely shows the photo of that name in another format."""
    if file.stem.casefold() != other.stem.casefold() or _order(file) <= _order(other):
        return False
    try:
        one, two = (_small_copy(path) for path in (file, other))
    except MissingDependencyError:
        return True
    except InputError:
        return False
    flat = min(one.std(), two.std()) < 1
    return not flat and float(np.corrcoef(one, two)[0, 1]) > _LIKE


def _small_copy(file: Path) -> np.ndarray:
    small = decode(file, 8 * _SMALL[0]).pixels.convert("L").resize(_SMALL)
    return np.asarray(small, np.float64).ravel()
