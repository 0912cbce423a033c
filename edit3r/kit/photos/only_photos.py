"""What among image files is not a photo of the scene: masks, our own sheets, and photos twice.

Pictures tell, not words in names: a file that is named after another one is a mask or a map where
it is grey, of few colours or see-through beside a photo in colour, and a copy where it shows the
same.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL.Image import Image

from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.reporting import say
from edit3r.kit.photos.decode import decode, image_size, read_header

# The numbers of this block: no figures kept.
MADE_HERE = "edit3r, no photo"
"""What sheets, previews and masks of ours carry as their software."""
_MIN_LIKENESS = 0.95  # correlation of small copies of one photo in two formats
# the same where the names differ: photos side by side are alike too
_MIN_LIKENESS_RENAMED = 0.995
_SMALL = (32, 32)  # size of the copies [pixels]
_DECODED = 8 * 32  # longer side at which files are decoded for that [pixels]
_MAX_ASPECT_DIFFERENCE = 0.02  # of width over height of two copies [shares]
_MIN_SPREAD = 1.0  # standard deviation of a copy that shows anything [levels]
_MAX_CHROMA = 6.0  # mean difference of the channels of a grey picture [levels]
_MAX_LABELS = 64  # colours of a picture of labels


def only_photos(files: Sequence[Path]) -> list[Path]:
    """The files without masks, sheets of ours and photos twice; says what was left out."""
    left_out = {file for file in files if _made_here(file)}
    photos = [file for file in files if file not in left_out]
    for file in sorted(photos, key=lambda one: -len(one.stem)):
        for other in photos:
            if not left_out & {file, other} and _is_named_after(file, other):
                left_out.update(_not_its_own(file, other))
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


def _not_its_own(file: Path, other: Path) -> list[Path]:
    """Which of a file and the one that it is named after is no photo of its own, if any: the map,
    or the copy, which is the file unless it has more pixels.
    """
    if _is_map_of(file, other):
        return [file]
    if not _show_the_same(file, other):
        return []
    return [other] if _pixel_count(file) > _pixel_count(other) else [file]


def _made_here(file: Path) -> bool:
    """Whether the file says of itself that it was made here."""
    try:
        return read_header(file).software == MADE_HERE
    except (InputError, MissingDependencyError):  # told where it is read
        return False


def _is_named_after(file: Path, other: Path) -> bool:
    """Whether a name begins or ends with the other's, and says more or has another suffix; phones
    call the edited copy of IMG_1 IMG_E1. img10 is not named after img1.
    """
    name, stem = (one.stem.casefold() for one in (file, other))
    if name == stem:
        original = min(file, other, key=_original_first)
        return file.suffix != other.suffix and original is other
    if _is_edited_copy(file, other):
        return True
    begins = name.startswith(stem) and not name[len(stem)].isalnum()
    return begins or (name.endswith(stem) and not name[-len(stem) - 1].isalnum())


def _is_edited_copy(file: Path, other: Path) -> bool:
    """Whether a phone named it so: IMG_E1 beside IMG_1."""
    name, stem = (one.stem.casefold() for one in (file, other))
    return name != stem and name.replace("img_e", "img_") == stem


def _original_first(file: Path) -> tuple[int, str]:
    """By which the original comes before the other formats of it: the one with most pixels."""
    return -_pixel_count(file), file.suffix


def _is_map_of(file: Path, other: Path) -> bool:
    """Whether a picture is see-through, grey or of few colours, beside a photo in colour."""
    try:
        mask, photo = (decode(one, _DECODED) for one in (file, other))
    except (InputError, MissingDependencyError):
        return False
    if photo.alpha is not None or _is_grey(photo.pixels):
        return False
    few = mask.pixels.getcolors(_MAX_LABELS) is not None
    return mask.alpha is not None or few or _is_grey(mask.pixels)


def _is_grey(pixels: Image) -> bool:
    values = np.asarray(pixels, np.int16)
    return float(np.ptp(values, axis=2).mean()) < _MAX_CHROMA


def _show_the_same(file: Path, other: Path) -> bool:
    """Whether small copies of two files are alike; of two formats of one name one may need a
    package that is missing, and then the other is enough.
    """
    renamed = file.stem.casefold() != other.stem.casefold()
    try:
        shapes = [width / height for height, width in map(image_size, (file, other))]
        if abs(shapes[0] / shapes[1] - 1) > _MAX_ASPECT_DIFFERENCE:
            return False
        one, two = (_small_copy(path) for path in (file, other))
    except MissingDependencyError:
        return not renamed or _is_edited_copy(file, other)
    except InputError:
        return False
    if min(one.std(), two.std()) < _MIN_SPREAD:
        return False
    likeness = float(np.corrcoef(one, two)[0, 1])
    return likeness > (_MIN_LIKENESS_RENAMED if renamed else _MIN_LIKENESS)


def _small_copy(file: Path) -> np.ndarray:
    small = decode(file, _DECODED).pixels.convert("L").resize(_SMALL)
    return np.asarray(small, np.float64).ravel()


def _pixel_count(file: Path) -> int:
    """Of a file that can be read here, else 0."""
    try:
        height, width = image_size(file)
    except (InputError, MissingDependencyError):
        return 0
    return height * width
