"""Mask files to the views' pixels, 1 where an image may change, 0 where it must not; and which file
belongs to which photo: by name, else in the order given.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from PIL import Image, ImageChops
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say, warn
from edit3r.kit.files.names import natural
from edit3r.kit.photos.decode import READABLE, SUFFIXES, DecodedImage, decode
from edit3r.kit.photos.framing import Frame
from edit3r.kit.photos.images import LoadedPhotos, expand, images_of_folder
from edit3r.kit.photos.intrinsics import SHAPE_TOLERANCE


def load_masks(
    paths: Sequence[str | Path], photos: LoadedPhotos
) -> Float[Tensor, "1 view height width"]:
    """One mask per photo, in the photos' order: black 0, white 1, greys between.

    A mask has the shape of its original photo (any size), and is then cropped as the photo was, or
    exactly the size of the view. Raises InputError for a wrong number, shape or file.
    """
    files = [Path(path) for path in paths]
    if len(files) != len(photos.photos):
        raise InputError(
            f"--mask: expected one mask per photo ({len(photos.photos)}), got {len(files)}."
        )
    masks = [read_mask(path, photo.frame) for path, photo in zip(files, photos.photos)]
    for path, mask in zip(files, masks):
        if not mask.any():
            warn(f"{path}: this mask is all black, so nothing may change in its view.")
    return torch.stack(masks)[None]


def _grey(decoded: DecodedImage, path: Path) -> Image.Image:
    """The mask in a picture, black to white: its alpha where all that is opaque has one colour."""
    if decoded.alpha is None:
        return _without_labels(decoded.pixels, path)
    alpha = np.asarray(decoded.alpha)
    most = int(alpha.max())
    marked = np.asarray(decoded.pixels)[alpha == most]
    # A hole in a picture may mean black to one program and white to another.
    if most == alpha.min() or np.ptp(marked, axis=0).max() > _FADED:
        raise InputError(
            f"{path}: this mask has transparent parts in a picture; expected black (keep) and "
            "white (may change), or one colour where it may change and else nothing."
        )
    say(
        "selection.alpha",
        f"what is opaque in {path.name} may change; --invert swaps inside and outside",
    )
    return decoded.alpha.point([255 * min(one, most) // most for one in range(256)])


_FADED = 12  # most that the channels of a grey differ [levels]
_DARK = 32  # below which the values of a mask are numbers of labels, not greys
_DARK_ALONE = 128  # the same of the only value besides black
_VOID = {(255,), (224, 224, 192)}  # what data sets draw around their labels
_LEAST_SHARE = 0.002  # of the picture that a label takes; a sanity limit
_MOST_LABELS = 12


def _without_labels(pixels: Image.Image, path: Path) -> Image.Image:
    """The grey mask of a picture whose object is a colour or a number, as annotation tools write.

    Raises InputError for several labels.
    """
    grey = pixels.convert("L")
    red, green, blue = pixels.split()
    colour = ImageChops.subtract(
        ImageChops.lighter(ImageChops.lighter(red, green), blue),
        ImageChops.darker(ImageChops.darker(red, green), blue),
    )
    is_grey = bool(np.mean(np.asarray(colour) > _FADED) < _LEAST_SHARE)
    if is_grey and not _holds_numbers(grey):
        return grey
    values = np.asarray(pixels, np.int16)
    # JPEG stores colours at half the size, so that they run out at edges.
    reach = 6 if path.suffix.lower() in (".jpg", ".jpeg") else 4
    labels = _labels(np.asarray(grey)[..., None] if is_grey else values, is_grey, reach)
    labels = [one for one in labels if one not in _VOID] or labels
    names = [str(one[0]) if is_grey else ",".join(map(str, one)) for one in labels]
    if len(labels) != 1:
        listed = " and ".join(names[:_MOST_LABELS]) or "many colours"
        raise InputError(
            f"{path}: holds {listed}, as a label image or a photo does; expected a mask of one "
            "thing, black (keep) and white (may change)."
        )
    if names == ["1"]:  # as programs write truth values
        warn(f"{path}: holds only the values 0 and 1; 1 is taken as white.")
    else:
        warn(f"{path}: a label image; its one label, {names[0]}, is taken as white.")
    label = np.array(labels[0] if not is_grey else labels[0] * 3, np.float32)
    share = (values @ label / (label @ label)).clip(0, 1)  # soft at soft edges
    for void in _VOID:
        share[(values == np.array(void)).all(-1)] = 0
    return Image.fromarray((255 * share).round().astype(np.uint8))


def _holds_numbers(grey: Image.Image) -> bool:
    """Whether the few values of a grey picture are numbers of labels, not how much may change."""
    values = set(np.unique(np.asarray(grey)).tolist())
    inside = values - {0, 255}
    alone = len(values) == 2 and 0 in values and max(values) < _DARK_ALONE
    return alone or 0 < max(inside, default=0) < _DARK


def _labels(
    values: Int[np.ndarray, "height width channel"], is_grey: bool, reach: int
) -> list[tuple[int, ...]]:
    """The values that take a part of the picture, but for black; most first.

    Shades of the first within `reach` times `_FADED` are its soft edges.
    """
    step = 1 if is_grey else 24  # JPEG and soft edges bring other shades
    kinds = np.zeros(values.shape[:2], np.int64)
    for channel in range(values.shape[-1]):
        kinds = 256 * kinds + values[..., channel] // step
    labels: list[np.ndarray] = []
    shares: list[float] = []
    for kind, count in sorted(
        zip(*np.unique(kinds, return_counts=True)), key=lambda one: -one[1]
    ):
        share = count / kinds.size
        if share < _LEAST_SHARE or len(labels) > _MOST_LABELS:
            break
        mean = np.rint(values[kinds == kind].mean(0)).astype(int)
        apart = min(np.abs(mean - other).max() for other in (0 * mean, *labels))
        rim = labels and share < 0.1 * shares[0] and _is_shade(mean, labels[0], reach)
        if apart >= (1 if is_grey else 3 * _FADED) and not (rim and not is_grey):
            labels.append(mean)
            shares.append(share)
    return [tuple(int(value) for value in one) for one in labels]


def _is_shade(colour: np.ndarray, label: np.ndarray, reach: int) -> bool:
    """Whether a colour lies between black and a label, as soft edges do."""
    nearest = (colour @ label) / (label @ label) * label
    return bool(np.abs(colour - nearest).max() < reach * _FADED)


def read_mask(path: Path, frame: Frame) -> Float[Tensor, "height width"]:
    """One mask file, of the photo's shape or the view's size, on the view that `frame` cuts."""
    decoded = decode(path)
    image, (height, width) = _grey(decoded, path), frame.source
    if image.size != frame.target[::-1]:
        if abs(image.width / image.height * height / width - 1) > SHAPE_TOLERANCE:
            raise InputError(
                f"{path}: this mask is {image.width}x{image.height}; expected the shape of its "
                "photo "
                f"({width}x{height}) or the size of its view ({frame.target[1]}x{frame.target[0]})."
            )
        # never leaves [0, 1], unlike Lanczos
        image = frame.cut(image, Image.Resampling.BILINEAR)
    return torch.from_numpy(np.array(image, dtype=np.float32) / 255)


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
    masks = {view: file for file, view in named.items() if view is not None}
    masks |= dict(zip(free, _as_photos_lie(rest, photos)))
    paired = [masks[view] for view in sorted(masks)]
    if folders or paired != files[: len(paired)] or (views and way == "by number"):
        pairs = ", ".join(f"{photos[v][0]} <- {masks[v].name}" for v in sorted(masks))
        say(
            "selection.masks",
            f"paired with the photos {way if views else 'in order'}: {pairs}",
        )
    return {view: masks[view] for view in sorted(masks)}


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
        of_photos = [
            file for file in inside if photo_named(file.stem, photos) is not None
        ]
        if not of_photos and len(inside) != len(photos):  # as many go in order
            of_photos = [file for file in inside if _number(file.name) in numbers]
        files += of_photos or inside
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
    numbered = {file: numbers.get(_number(file.name)) for file in files}
    clear = len(numbers) == len(photos) and None not in {*numbers, *numbered.values()}
    return numbered if clear else dict.fromkeys(files)


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
