"""Mask files to the views' pixels: 1 where an image may change, 0 where it must not."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from PIL import Image, ImageChops
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say, warn
from edit3r.kit.photos.decode import DecodedImage, decode
from edit3r.kit.photos.framing import Frame
from edit3r.kit.photos.images import LoadedPhotos
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
        f"what is opaque in {path.name} may change; --invert for the contrary",
    )
    return decoded.alpha.point([255 * min(one, most) // most for one in range(256)])


_FADED = 12  # most that the channels of a grey differ [levels]
_DARK = 32  # below which the values of a mask are numbers of labels, not greys
_DARK_ALONE = 128  # the same of the only value besides black
_VOID = {(255,), (224, 224, 192)}  # what data sets draw around their labels
_LEAST_SHARE = 0.002  # of the picture that a label takes
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
    found: list[np.ndarray] = []
    shares: list[float] = []
    for kind, count in sorted(
        zip(*np.unique(kinds, return_counts=True)), key=lambda one: -one[1]
    ):
        share = count / kinds.size
        if share < _LEAST_SHARE or len(found) > _MOST_LABELS:
            break
        mean = np.rint(values[kinds == kind].mean(0)).astype(int)
        apart = min(np.abs(mean - other).max() for other in (0 * mean, *found))
        rim = found and share < 0.1 * shares[0] and _is_shade(mean, found[0], reach)
        if apart >= (1 if is_grey else 3 * _FADED) and not (rim and not is_grey):
            found.append(mean)
            shares.append(share)
    return [tuple(int(value) for value in one) for one in found]


def _is_shade(colour: np.ndarray, label: np.ndarray, reach: int) -> bool:
    """Whether a colour lies between black and a label, as soft edges do."""
    nearest = (colour @ label) / (label @ label) * label
    return bool(np.abs(colour - nearest).max() < reach * _FADED)


def read_mask(path: Path, frame: Frame) -> Float[Tensor, "height width"]:
    """One mask file, of the photo's shape or the view's size, on the view that `frame` cuts from
    the photo.
    """
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
