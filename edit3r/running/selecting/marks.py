"""Marks as people type them: clicks, strokes, boxes, regions and masks, read into a Selection."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.instructions import Target
from edit3r.contract.interfaces import Box, Reader, Selection
from edit3r.contract.lens import Lens
from edit3r.kit import asking
from edit3r.kit.photos.framing import Frame
from edit3r.kit.photos.images import LoadedPhotos
from edit3r.kit.photos.masks import load_masks, masks_by_photo, read_mask
from edit3r.running.config import MAX_PROMPT
from edit3r.running.editors import usual_reader


@dataclass(frozen=True)
class MarkTexts:
    """What is marked, in words and files. Places are `[N:]X,Y`, boxes and regions
    `[N:]X,Y,W,H` and strokes `[N:]X,Y,X,Y,...`.

    N is the number of the photo, from 1. Numbers are pixels of the original photo or, where none is
    above 1, shares of its sides.
    """

    points: tuple[str, ...] = ()
    not_points: tuple[str, ...] = ()
    boxes: tuple[str, ...] = ()
    mask_files: tuple[str, ...] = ()
    thing: str = ""  # in words, such as "the left cup"
    strokes: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()

    @property
    def given(self) -> bool:
        return any(
            (
                self.points,
                self.not_points,
                self.boxes,
                self.mask_files,
                self.thing,
                self.strokes,
                self.regions,
            )
        )

    def read(self, photos: LoadedPhotos, reader: Reader | None = None) -> Selection:
        """The marks on these photos, words by `reader` or the usual one.

        Raises InputError for a mark that fits no photo.
        """
        if len(self.thing) > MAX_PROMPT:
            raise InputError(
                f"--thing: expected at most {MAX_PROMPT} characters, got {len(self.thing)}."
            )
        frames = [photo.frame for photo in photos.photos]
        positive = tuple(read_point("--point", text, frames) for text in self.points)
        negative = tuple(
            read_point("--not-point", text, frames) for text in self.not_points
        )
        boxes = dict(_box("--box", text, frames) for text in self.boxes)
        masks = self._masks(photos)
        thing = self._named(reader)
        return Selection(
            positive,
            negative,
            boxes,
            masks=masks,
            words=thing.name,
            qualifiers=thing.qualifiers,
            several=thing.several,
            strokes=tuple(_stroke("--stroke", text, frames) for text in self.strokes),
            regions=tuple(_box("--region", text, frames) for text in self.regions),
        )

    def _named(self, reader: Reader | None) -> Target:
        """The thing in words, with a name to look for; without words one without a name."""
        if not self.thing.strip():
            return Target()
        thing = asking.read_target(reader or usual_reader(), self.thing)
        scope = {"whole": "everything"}.get(thing.scope, thing.scope)
        return replace(thing, name=thing.name or scope)

    def for_photos(self, found: list[str], used: list[str]) -> "MarkTexts":
        """The same marks where only some of the photos that were found are used."""
        if not self.mask_files:
            return self
        masks = masks_by_photo(self.mask_files, [(Path(file).name,) for file in found])
        kept = [mask for view, mask in masks.items() if found[view] in used]
        # A single mask of no photo's name is the first one's that is used.
        return replace(self, mask_files=tuple(map(str, kept or masks.values())))

    def _masks(self, photos: LoadedPhotos) -> dict[int, Float[Tensor, "height width"]]:
        """The mask of each photo that has one."""
        if not self.mask_files:
            return {}
        names = [(Path(photo.file).name, photo.name) for photo in photos.photos]
        found = masks_by_photo(self.mask_files, names)
        if len(found) == len(names):
            return dict(enumerate(load_masks(list(found.values()), photos)[0]))
        frames = [photo.frame for photo in photos.photos]
        return {view: read_mask(path, frames[view]) for view, path in found.items()}


def read_point(flag: str, text: str, frames: list[Frame]) -> tuple[int, float, float]:
    """View, x and y [shares of the view] of `[N:]X,Y`."""
    view, numbers = _numbers(flag, text, frames, "X,Y")
    return (view, *_place(flag, text, _as_shares(numbers, frames[view]), view, frames))


def _stroke(
    flag: str, text: str, frames: list[Frame]
) -> tuple[int, tuple[tuple[float, float], ...]]:
    """View, and x and y [shares of the view] of the places of `[N:]X,Y,X,Y,...`."""
    view, numbers = _numbers(flag, text, frames, "X,Y,X,Y,...")
    shares = _as_shares(numbers, frames[view])
    pairs = list(zip(shares[::2], shares[1::2]))
    return view, tuple(_place(flag, text, pair, view, frames) for pair in pairs)


def _place(
    flag: str, text: str, shares: Sequence[float], view: int, frames: list[Frame]
) -> tuple[float, float]:
    """A place on the original photo [shares] on what is used of it."""
    (x, y), frame = shares, frames[view]
    if frame.lens is not None:
        x, y = frame.lens.undistorted_place(x, y)
    place = _in_crop(x, y, frame)
    if min(place) < 0 or max(place) > 1:
        raise _outside(flag, text, view, frame)
    return place


def _box(flag: str, text: str, frames: list[Frame]) -> tuple[int, Box]:
    """View and box [shares of the view] of `[N:]X,Y,W,H`, cut to the part that is used."""
    view, numbers = _numbers(flag, text, frames, "X,Y,W,H")
    frame = frames[view]
    x, y, width, height = _as_shares(numbers, frame)
    if min(width, height) < 0:
        raise InputError(f"{flag} {text}: width and height must be at least 0.")
    corners = ((x, y), (x + width, y + height))
    if frame.lens is not None:
        corners = _straightened(corners, frame.lens)
    (left, top), (right, bottom) = (_in_crop(*corner, frame) for corner in corners)
    left, top = max(0.0, left), max(0.0, top)
    if left >= min(1.0, right) or top >= min(1.0, bottom):
        raise _outside(flag, text, view, frame)
    height, width = frame.target
    if (right - left) * width < 1 or (bottom - top) * height < 1:
        raise InputError(
            f"{flag} {text}: contains no pixel of photo {view + 1} as it is used "
            f"({width} x {height} pixels); give a larger one."
        )
    return view, (left, top, min(1.0, right) - left, min(1.0, bottom) - top)


def _numbers(
    flag: str, text: str, frames: list[Frame], shape: str
) -> tuple[int, list[float]]:
    """View and numbers of a mark; `shape` is how it must read."""
    where, _, listed = text.rpartition(":")
    try:
        view = int(where) - 1 if where else 0
        values = [float(number) for number in listed.split(",")]
    except ValueError:
        view, values = -1, []
    wanted = len(shape.split(","))
    fits = len(values) == wanted
    if shape.endswith("..."):
        fits = len(values) >= wanted - 1 and len(values) % 2 == 0
    if not fits or not 0 <= view < len(frames):
        raise InputError(
            f"{flag} {text}: expected {shape} on the first photo or N:{shape} on photo N (1 to "
            f"{len(frames)}), in pixels of the original photo or, where no number is above 1, in "
            "shares of its sides."
        )
    if not all(-1e9 < value < 1e9 for value in values):  # NaN is in no range
        raise InputError(f"{flag} {text}: expected finite numbers.")
    return view, values


def _outside(flag: str, text: str, view: int, frame: Frame) -> InputError:
    height, width = frame.source
    left, top, right, bottom = map(round, frame.box)
    return InputError(
        f"{flag} {text}: lies outside of what is used of photo {view + 1}: x from {left} to "
        f"{right} and y from {top} to {bottom} of its {width} x {height} pixels."
    )


def _as_shares(values: tuple[float, ...] | list[float], frame: Frame) -> list[float]:
    """The numbers as shares of the original photo's sides."""
    if max(values) <= 1:
        return list(values)
    height, width = frame.source
    return [value / side for value, side in zip(values, cycle((width, height)))]


def _in_crop(x: float, y: float, frame: Frame) -> tuple[float, float]:
    """A place on the original photo [shares] as shares of the part that is used."""
    height, width = frame.source
    left, top, right, bottom = frame.box
    return (x * width - left) / (right - left), (y * height - top) / (bottom - top)


def _straightened(
    corners: tuple[tuple[float, float], tuple[float, float]], lens: Lens
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The box around the four corners of a box, on the straightened photo."""
    (left, top), (right, bottom) = corners
    places = [
        lens.undistorted_place(x, y) for x in (left, right) for y in (top, bottom)
    ]
    columns, rows = zip(*places)
    return (min(columns), min(rows)), (max(columns), max(rows))
