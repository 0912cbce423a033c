"""What among image files is not a photo of the scene: masks, our own sheets, and photos twice."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.reporting import say
from edit3r.kit.photos.decode import decode, image_size, read_header

# The numbers of this block: no figures kept.
MADE_HERE = "edit3r, no photo"
"""What sheets, previews and masks of ours carry as their software."""
_OWN_NAMES = ("edit3r-preview", "before_after")
_MAPS = "masks?|mattes?|alpha|depth|disparity|normals?|seg(?:mentation)?|labels?"
_NUMBER = r"(?:[ _.-]?\d{1,5})?$"  # of the object, or bits
_MAP_SIGN = re.compile(
    rf"[ _.-]?masks?{_NUMBER}|[ _.-](?:{_MAPS}){_NUMBER}|^(?:{_MAPS})[ _.-]"
)
_SUFFIX = re.compile(r"\.(jpe?g|png|tiff?|webp|heic|bmp)$")
_COPY_WORDS = "copy|kopie|kopia|copie|copia|cópia|kopi|копия"
_COPY_SIGN = re.compile(
    rf"( ?\(\d+\)| \d+|~\d+| - ({_COPY_WORDS}).*|[-_ ]({_COPY_WORDS})( \d+)?"
    rf"|[-_ ](thumb(nail)?|small|resized|edit(ed)?))$|^({_COPY_WORDS})( of| de| von)? "
)
_LIKE = 0.95  # correlation of small copies of one photo in two formats
_COPIED = 0.995  # the same where the names differ: photos side by side are alike too
_SMALL = (32, 32)  # their size [pixels]


def only_photos(files: Sequence[Path]) -> list[Path]:
    """The files without masks, sheets of ours and second formats; says what was left out."""
    stems = Counter(file.stem.casefold() for file in files)
    photos_once = _without_doubles(
        [file for file in files if not _is_none(file, stems)]
    )
    photos = set(photos_once)
    left_out = [file.name for file in files if file not in photos]
    if not photos_once or not left_out:
        return list(files)
    listed = ", ".join(left_out[:6]) + (", ..." if len(left_out) > 6 else "")
    say(
        "photos.left_out",
        f"{listed}: no photo of its own (a mask, a sheet, or a photo twice)",
    )
    return photos_once


def _is_none(file: Path, stems: Mapping[str, int]) -> bool:
    """Whether a file is a mask or map of a photo (`stems` are all files'), or a sheet made here."""
    stem = file.stem.casefold()
    without = _SUFFIX.sub("", _MAP_SIGN.sub("", stem))
    return (
        stem in _OWN_NAMES or (without != stem and without in stems) or _made_here(file)
    )


def _made_here(file: Path) -> bool:
    """Whether the file says of itself that it was made here."""
    try:
        return read_header(file).software == MADE_HERE
    except (InputError, MissingDependencyError):  # told where it is read
        return False


def _without_doubles(files: Sequence[Path]) -> list[Path]:
    """Of files of one stem, or named as its copies, that show the same, only the largest."""
    stems = {file.stem.casefold() for file in files}
    by_stem: dict[str, list[Path]] = {}
    for file in files:
        by_stem.setdefault(_copied_from(file.stem.casefold(), stems), []).append(file)
    left_out: set[Path] = set()
    for stem, twins in by_stem.items():
        originals = [file for file in twins if file.stem.casefold() == stem]
        copies = [file for file in twins if file.stem.casefold() != stem]
        # the original, where no copy has more pixels
        best, *others = originals + copies
        for twin in others:
            renamed = best.stem.casefold() != twin.stem.casefold()
            if best.suffix == twin.suffix and not renamed:
                continue  # of two folders
            if not _show_the_same(best, twin, _COPIED if renamed else _LIKE):
                continue
            worse = twin if _pixels(best) >= _pixels(twin) else best
            best = twin if worse is best else best
            left_out.add(worse)
    return [file for file in files if file not in left_out]


def _copied_from(stem: str, stems: set[str]) -> str:
    """The stem of the file that this one is named as a copy of; its own without one."""
    for original in (_COPY_SIGN.sub("", stem), re.sub(r"^img_e(?=\d)", "img_", stem)):
        if original != stem and original in stems:
            return original
    return stem


def _show_the_same(first: Path, second: Path, like: float) -> bool:
    """Whether small copies of two files are alike; of two formats one may need a package that is
    missing, and then the other is enough.
    """
    try:
        sizes = [image_size(file) for file in (first, second)]
        shapes = [width / height for height, width in sizes]
        if abs(shapes[0] / shapes[1] - 1) > 0.02:
            return False
        one, other = (_small_copy(file) for file in (first, second))
    except MissingDependencyError:
        return True
    except InputError:
        return False
    if min(one.std(), other.std()) < 1:
        return False
    return float(np.corrcoef(one, other)[0, 1]) > like


def _small_copy(file: Path) -> np.ndarray:
    small = decode(file, 8 * _SMALL[0]).pixels.convert("L").resize(_SMALL)
    return np.asarray(small, np.float64).ravel()


def _pixels(file: Path) -> int:
    """Of a file that can be read here, else 0."""
    try:
        height, width = image_size(file)
    except (InputError, MissingDependencyError):
        return 0
    return height * width
