"""Which mask files belong to which photos: by name, else in the order given."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say
from edit3r.kit.photos.images import expand, images_of_folder

_Names = Sequence[str]
"""What one photo is called: its file's name, and its view's."""


def masks_by_photo(given: Sequence[str], photos: Sequence[_Names]) -> dict[int, Path]:
    """The mask of each photo that has one, by the photo's number.

    `given` are files, folders of masks, and wildcards that no shell expanded. A mask whose name is
    a photo's with something before or behind, such as left_mask.png or left.jpg.png, is that
    photo's. Others follow in the order given, where there is one for each photo; a single one is
    the first photo's. Raises InputError where that leaves a mask without a photo.
    """
    files, folders = _files(given, photos)
    named = {file: _photo_named(file, photos) for file in files}
    views = [view for view in named.values() if view is not None]
    if len(set(views)) < len(views):
        if len(files) != len(photos):
            raise _confusing(given, len(files), photos)
        views, named = [], dict.fromkeys(files)
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
    found |= dict(zip(free, rest))
    if folders or list(found.values()) != [found[view] for view in sorted(found)]:
        pairs = ", ".join(f"{photos[v][0]} <- {found[v].name}" for v in sorted(found))
        way = "by name" if views else "in order"
        say("selection.masks", f"paired with the photos {way}: {pairs}")
    return {view: found[view] for view in sorted(found)}


def _files(given: Iterable[str], photos: Sequence[_Names]) -> tuple[list[Path], bool]:
    """The files that are meant, and whether a folder was. Of a folder that names photos, only these
    count: it may hold other pictures too.
    """
    files, folders = [], False
    for path in (one for text in given for one in expand(text)):
        if not path.is_dir():
            files.append(path)
            continue
        folders = True
        inside = images_of_folder(path)
        own = [file for file in inside if _photo_named(file, photos) is not None]
        files += own or inside
        if not inside:
            raise InputError(f"--mask {path}: no images in this folder.")
    return files, folders


def _photo_named(file: Path, photos: Sequence[_Names]) -> int | None:
    """The photo whose name a mask's holds, the longest such name; None for none, or several."""
    text = file.stem.casefold()
    lengths = [
        max((len(name) for name in _stems(names) if _speaks_of(text, name)), default=0)
        for names in photos
    ]
    longest = max(lengths, default=0)
    views = [view for view, length in enumerate(lengths) if length == longest]
    return views[0] if longest and len(views) == 1 else None


def _stems(names: _Names) -> set[str]:
    return {
        stem for name in names for stem in (name.casefold(), Path(name).stem.casefold())
    }


def _speaks_of(text: str, name: str) -> bool:
    """Whether a mask is named after a photo; img10 is not after img1."""
    before, found, behind = text.partition(name)
    if not found:
        return False
    if not before:
        return not (name[-1:].isdigit() and behind[:1].isdigit())
    return not behind and before[-1] in "_-. "


def _confusing(
    given: Sequence[str], masks: int, photos: Sequence[_Names]
) -> InputError:
    return InputError(
        f"--mask {' '.join(map(str, given[:3]))}: {masks} masks for {len(photos)} photos; give one "
        "per photo, or name each after its photo, such as left_mask.png for left.jpg."
    )
