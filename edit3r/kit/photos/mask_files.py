"""Which files belong to which photos: by name, and masks else in the order given."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say
from edit3r.kit.files.names import natural
from edit3r.kit.photos.decode import READABLE, SUFFIXES
from edit3r.kit.photos.images import expand, images_of_folder

MASK_SUFFIXES = (*SUFFIXES, ".gif")
"""Files taken from a folder of masks; among photos a GIF is an animation, or a picture of a page.
"""

Names = Sequence[str]
"""What one photo is called: its file's name, and its view's."""


def masks_by_photo(given: Sequence[str], photos: Sequence[Names]) -> dict[int, Path]:
    """The mask of each photo that has one, by the photo's number.

    `given` are files, folders of masks, and wildcards that no shell expanded. A mask whose name is
    a photo's with something before or behind, such as left_mask.png or left.jpg.png, is that
    photo's, and one in a folder of that name, such as left/0.png; else one with the photo's number,
    such as mask_2.png of IMG_2.jpg. Others follow in the order given, where there is one for each
    photo; a single one is the first photo's. Raises InputError where that leaves a mask without a
    photo.
    """
    files, folders = _files(given, photos)
    named = {file: photo_named(file.stem, photos) for file in files}
    way = "by name"
    if not any(view is not None for view in named.values()):
        named = {file: photo_named(file.parent.name, photos) for file in files}
        if len({file.parent for file in files}) < len(files):
            named = dict.fromkeys(files)
    if not any(view is not None for view in named.values()):
        named, way = _photos_numbered(files, photos), "by number"
    views = [view for view in named.values() if view is not None]
    if len(set(views)) < len(views):
        raise _confusing(given, len(files), photos)
    rest = [file for file in files if named[file] is None]
    free = [view for view in range(len(photos)) if view not in views]
    if len(rest) != len(free) and rest:
        if len(files) == 1:
            free = [0]
        elif not free:
            rest = []  # masks of photos that are not here
        else:
            raise _confusing(given, len(files), photos)
    found = {view: file for file, view in named.items() if view is not None}
    found |= dict(zip(free, _as_photos_lie(rest, photos)))
    paired = [found[view] for view in sorted(found)]
    if folders or paired != files[: len(paired)] or (views and way == "by number"):
        pairs = ", ".join(f"{photos[v][0]} <- {found[v].name}" for v in sorted(found))
        say(
            "selection.masks",
            f"paired with the photos {way if views else 'in order'}: {pairs}",
        )
    return {view: found[view] for view in sorted(found)}


def _files(given: Iterable[str], photos: Sequence[Names]) -> tuple[list[Path], bool]:
    """The files that are meant, and whether a folder was. Of a folder that names photos, only these
    count: it may hold other pictures too.
    """
    files, folders = [], False
    numbers = {_number(names[0]) for names in photos} - {None}
    for path in (one for text in given for one in expand(text)):
        if not path.is_dir():
            files.append(path)
            continue
        folders = True
        inside = images_of_folder(path, MASK_SUFFIXES) or _one_a_photo(path, photos)
        own = [file for file in inside if photo_named(file.stem, photos) is not None]
        if not own and len(inside) != len(photos):  # as many go in order
            own = [file for file in inside if _number(file.name) in numbers]
        files += own or inside
    return files, folders


def _one_a_photo(path: Path, photos: Sequence[Names]) -> list[Path]:
    """The masks in a folder's folders, which are called like the photos, as of programs that find
    several things in each. Raises InputError where one holds several: which are meant?
    """
    deeper = sorted(path.iterdir(), key=natural)
    inside = [images_of_folder(one, MASK_SUFFIXES) for one in deeper]
    several = [
        files
        for files in inside
        if files and photo_named(files[0].parent.name, photos) is not None
    ]
    if not several:
        raise InputError(
            f"--mask {path}: no images in this folder; expected {READABLE}."
        )
    if max(map(len, several)) > 1:
        firsts = " ".join(str(files[0]) for files in several[:2])
        raise InputError(
            f"--mask {path}: {max(map(len, several))} masks of one photo; expected one for each. "
            f"Name those of the thing that is meant, such as --mask {firsts}"
        )
    return [files[0] for files in several]


def photo_named(stem: str, photos: Sequence[Names]) -> int | None:
    """The photo whose name a mask's holds, the longest such name; None for none, or several."""
    text = _spelled(stem)
    lengths = [
        max((len(name) for name in _stems(names) if _speaks_of(text, name)), default=0)
        for names in photos
    ]
    longest = max(lengths, default=0)
    views = [view for view, length in enumerate(lengths) if length == longest]
    return views[0] if longest and len(views) == 1 else None


def _stems(names: Names) -> set[str]:
    return {_spelled(stem) for name in names for stem in (name, Path(name).stem)}


def _spelled(name: str) -> str:
    """A name as programs that rename files leave it recognisable: in any case and signs."""
    return re.sub(r"[ _.-]+", "_", name.casefold())


def _speaks_of(text: str, name: str) -> bool:
    """Whether a mask is named after a photo; img10 is not after img1."""
    if text.startswith(name):
        return not (name[-1:].isdigit() and text[len(name) :][:1].isdigit())
    return bool(re.search(rf"(^masks?|_){re.escape(name)}(_|$)", text))


def _photos_numbered(
    files: Sequence[Path], photos: Sequence[Names]
) -> dict[Path, int | None]:
    """The photo of each mask's number; of none where one number is no photo's, or two are alike."""
    numbers = {_number(names[0]): view for view, names in enumerate(photos)}
    found = {file: numbers.get(_number(file.name)) for file in files}
    clear = len(numbers) == len(photos) and None not in {*numbers, *found.values()}
    return found if clear else dict.fromkeys(files)


def _number(name: str) -> int | None:
    """The last number of a file's name."""
    digits = re.findall(r"\d+", Path(name).stem)
    return int(digits[-1]) if digits else None


def _as_photos_lie(files: list[Path], photos: Sequence[Names]) -> list[Path]:
    """The masks in natural order where a shell sorted them, and the photos lie in that order."""
    names = [Path(photo[0]) for photo in photos]
    by_shell = [file.name for file in files] == sorted(file.name for file in files)
    if by_shell and names == sorted(names, key=natural):
        return sorted(files, key=lambda file: natural(Path(file.stem)))
    return files


def _confusing(given: Sequence[str], masks: int, photos: Sequence[Names]) -> InputError:
    return InputError(
        f"--mask {' '.join(map(str, given[:3]))}: {masks} masks for {len(photos)} photos; give one "
        "per photo, or name each after its photo, such as left_mask.png for left.jpg."
    )
