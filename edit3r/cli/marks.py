"""The flags that say which object is meant, read into a Selection: --point, --not-point, --box and
--mask.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from edit3r.errors import InputError

if TYPE_CHECKING:
    from edit3r.io.framing import Frame, Lens
    from edit3r.io.images import LoadedPhotos
    from edit3r.selection.select import Selection


def selection_from(
    args: argparse.Namespace, photos: "LoadedPhotos"
) -> "Selection | None":
    """What the flags mark on these photos; None where they mark nothing. Raises InputError for what
    fits no photo.
    """
    from edit3r.io.masks import read_mask
    from edit3r.selection.select import Selection

    positive = tuple(_place("--point", text, photos, 2) for text in args.point)
    negative = tuple(_place("--not-point", text, photos, 2) for text in args.not_point)
    boxes = {
        view: tuple(box)
        for view, *box in (_place("--box", text, photos, 4) for text in args.box)
    }
    masks = {
        _photo_of_mask(path, args.mask, photos): path for path in map(Path, args.mask)
    }
    if not (positive or negative or boxes or masks):
        return None
    read = {
        view: read_mask(path, photos.photos[view].frame) for view, path in masks.items()
    }
    return Selection(positive, negative, boxes, masks=read)


def _place(flag: str, text: str, photos: "LoadedPhotos", count: int) -> tuple[int, ...]:
    """View and `count` numbers of [PHOTO:]X,Y[,W,H], in shares of the view."""
    where, _, numbers = text.rpartition(":")
    try:
        view = int(where) - 1 if where else 0
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        view, values = -1, []
    if len(values) != count or not 0 <= view < len(photos.photos):
        shape = "X,Y" if count == 2 else "X,Y,W,H"
        raise InputError(
            f"{flag} {text}: expected {shape} on the first photo or N:{shape} on photo N (1 to "
            f"{len(photos.photos)}), "
            "in pixels of the original photo or, where no number is above 1, in shares of its "
            "sides."
        )
    places = _in_view(values, photos.photos[view].frame)
    if min(places) < 0 or max(places[:2]) > 1:
        raise InputError(
            f"{flag} {text}: lies outside of what is used of photo {view + 1}."
        )
    return (view, *places)


def _in_view(values: list[float], frame: "Frame") -> list[float]:
    """x, y (and width, height) on the original photo as shares of the part that is used; a box is
    cut to it.
    """
    height, width = frame.source
    if max(values) > 1:
        values = [value / side for value, side in zip(values, (width, height) * 2)]
    if frame.lens is not None:
        values = _straightened(values, frame.lens)
    left, top, right, bottom = frame.box
    shares = (width / (right - left), height / (bottom - top))
    x, y = (
        values[0] * shares[0] - left / (right - left),
        values[1] * shares[1] - top / (bottom - top),
    )
    if len(values) == 2:
        return [x, y]
    far_x, far_y = (
        min(1.0, x + values[2] * shares[0]),
        min(1.0, y + values[3] * shares[1]),
    )
    x, y = max(0.0, x), max(0.0, y)
    return [x, y, far_x - x, far_y - y]


def _straightened(values: list[float], lens: "Lens") -> list[float]:
    """A place, or the box around the four corners of a box, on the straightened photo."""
    if len(values) == 2:
        return list(lens.straightened_place(*values))
    x, y, width, height = values
    corners = [
        lens.straightened_place(x + a * width, y + b * height)
        for a in (0, 1)
        for b in (0, 1)
    ]
    (left, top), (right, bottom) = map(min, zip(*corners)), map(max, zip(*corners))
    return [left, top, right - left, bottom - top]


def _photo_of_mask(path: Path, given: list[str], photos: "LoadedPhotos") -> int:
    """The photo that a mask belongs to: the one in its name, else the first where it is the only
    mask.
    """
    named = [
        view
        for view, photo in enumerate(photos.photos)
        if path.stem.startswith(Path(photo.file).stem)
    ]
    if len(named) == 1 or (len(given) == 1 and not named):
        return named[0] if named else 0
    raise InputError(
        f"--mask {path}: {len(given)} masks for {len(photos.photos)} photos; give one per photo, "
        "or name each after "
        "its photo, such as left_mask.png for left.jpg."
    )


def add_mark_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that `selection_from` reads."""
    add, many = parser.add_argument, {"action": "append", "default": []}
    add(
        "--point",
        metavar="[N:]X,Y",
        help="a point on the object, on the first photo or photo N; repeatable",
        **many,
    )
    add(
        "--not-point",
        metavar="[N:]X,Y",
        help="a point on what is not the object; repeatable",
        **many,
    )
    add(
        "--box",
        metavar="[N:]X,Y,W,H",
        help="a box around the object, on the first photo or photo N",
        **many,
    )
    text = "a mask for each photo, or for one, which is carried to the rest; white is the object"
    add("--mask", nargs="+", action="extend", default=[], metavar="FILE", help=text)
