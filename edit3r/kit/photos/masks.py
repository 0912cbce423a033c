"""Mask files to the views' pixels: 1 where an image may change, 0 where it must not."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import warn
from edit3r.kit.photos.decode import decode
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


def read_mask(path: Path, frame: Frame) -> Float[Tensor, "height width"]:
    """One mask file, of the photo's shape or the view's size, on the view that `frame` cuts from
    the photo.
    """
    decoded = decode(path)
    if decoded.transparent:  # a hole may mean black to one program and white to another
        raise InputError(
            f"{path}: this mask has transparent parts; expected black (keep) and white (may "
            "change)."
        )
    image, (height, width) = decoded.pixels.convert("L"), frame.source
    if image.getextrema() == (0, 1):  # as programs write truth values
        warn(f"{path}: holds only the values 0 and 1; 1 is taken as white.")
        image = image.point(lambda value: 255 * value)
    if image.size != frame.target[::-1]:
        if abs(image.width / image.height * height / width - 1) > SHAPE_TOLERANCE:
            raise InputError(
                f"{path}: this mask is {image.width}x{image.height}; expected the shape of its "
                "photo "
                f"({width}x{height}) or the size of its view ({frame.target[1]}x{frame.target[0]})."
            )
        image = frame.cut(
            image, Image.Resampling.BILINEAR
        )  # never leaves [0, 1], unlike Lanczos
    return torch.from_numpy(np.array(image, dtype=np.float32) / 255)
