"""Photos that are files for a while, inside a block of `temporary_photos`: frames of videos, and
what a program holds in memory (arrays, tensors, PIL images, bytes of files), so that all photos go
through the one door that files go through.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import scratch_folder

EXPECTED = (
    "files, arrays [height, width, 3] of bytes or of floats in [0, 1], tensors [3, height, width], "
    "PIL images, or edit3r.Views"
)
_CHANNELS = (1, 3, 4)
Picture = str | Path | bytes | np.ndarray | Tensor | Image.Image
Pictures = Picture | Sequence[Picture]


class TakenPhotos:
    """Photos that are files for a while: frames of videos, pictures from memory."""

    def __init__(self) -> None:
        self.folders = ExitStack()  # closed, it removes them
        self.origins: dict[Path, str] = {}  # what each is of, as people know it

    def new_folder(self, name: str) -> Path:
        """A new folder that lasts as long as these photos do."""
        return self.folders.enter_context(scratch_folder(name))


_taken: ContextVar[TakenPhotos | None] = ContextVar("edit3r_photos", default=None)


def taken_photos() -> TakenPhotos:
    """Those of the block of `temporary_photos` around the call; there must be one."""
    taken = _taken.get()
    if taken is None:
        raise RuntimeError(
            "frames of a video and pictures in memory become files inside a block of "
            "edit3r.kit.photos.temporary.temporary_photos() only, and none is around this call."
        )
    return taken


@contextmanager
def temporary_photos() -> Iterator[None]:
    """Remove photos that are made inside the block when it ends; of nested ones, the outer one."""
    if _taken.get() is not None:
        yield
        return
    taken = TakenPhotos()
    token = _taken.set(taken)
    try:
        with taken.folders:
            yield
    finally:
        _taken.reset(token)


def origin(file: Path) -> str:
    """The file as people know it: for a frame of a video, the video and the frame's number."""
    taken = _taken.get()
    return str(file) if taken is None else taken.origins.get(file, str(file))


def as_files(photos: Any, name: str = "photos") -> list[str | Path]:
    """The photos as paths; what is in memory is written as PNG into a folder that goes with the
    process. Raises InputError for what is no photo.

    Pictures are RGB; a fourth channel is alpha. A stack of several is taken apart.
    """
    items = _items(photos)
    if all(isinstance(item, str | Path) for item in items):
        return items
    folder = None
    files: list[str | Path] = []
    for number, item in enumerate(items, start=1):
        if isinstance(item, str | Path):
            files.append(item)
            continue
        label = f"{name}: number {number}"
        folder = folder or taken_photos().new_folder("edit3r-photos")
        file = folder / f"photo-{number}.png"
        _write(item, file, label)
        taken_photos().origins[file] = file.name
        files.append(file)
    return files


def _items(photos: Any) -> list[Any]:
    if isinstance(photos, str | Path | bytes | Image.Image) or hasattr(photos, "read"):
        return [photos]
    if isinstance(photos, np.ndarray | Tensor):
        return list(photos) if photos.ndim == 4 else [photos]
    try:
        items = list(photos)
    except TypeError:
        raise InputError(f"photos: got {_kind(photos)}, expected {EXPECTED}.") from None
    stack = np.ndarray | Tensor
    return [
        one
        for item in items
        for one in (_items(item) if isinstance(item, stack) else [item])
    ]


def _write(item: Any, file: Path, label: str) -> None:
    """Write what is no path to a file. Raises InputError."""
    if hasattr(item, "read"):
        item = item.read()
    if isinstance(item, bytes | bytearray | memoryview):
        file.write_bytes(item)
    elif isinstance(item, Image.Image):
        profile = {
            key: item.info[key] for key in ("icc_profile",) if item.info.get(key)
        }
        mode = item.mode if item.mode in ("RGB", "RGBA", "L", "LA", "I;16") else "RGB"
        item.convert(mode).save(file, exif=item.getexif(), compress_level=1, **profile)
    else:
        Image.fromarray(_pixels(item, label)).save(file, compress_level=1)


def _pixels(item: Any, label: str) -> np.ndarray:
    """Bytes [height, width] or [height, width, 3 or 4] of an array or a tensor."""
    values: np.ndarray
    if isinstance(item, Tensor):
        values = (item.float() if item.dtype == torch.bfloat16 else item).numpy(
            force=True
        )
    elif isinstance(item, np.ndarray) or hasattr(item, "__array__"):
        values = np.asarray(item)
    else:
        raise InputError(f"{label} is {_kind(item)}; expected {EXPECTED}.")
    first = isinstance(item, Tensor) or (
        values.ndim == 3 and values.shape[2] not in _CHANNELS
    )
    if values.ndim == 3 and first and values.shape[0] in _CHANNELS:
        values = values.transpose(1, 2, 0)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    is_image = values.ndim == 2 or (values.ndim == 3 and values.shape[2] in (3, 4))
    if not is_image or values.size == 0:
        raise InputError(
            f"{label} is of shape {list(values.shape)}; expected {EXPECTED}."
        )
    return _bytes(values, label)


def _bytes(values: np.ndarray, label: str) -> np.ndarray:
    kind = values.dtype
    if kind == np.uint8:
        return np.ascontiguousarray(values)
    if kind == np.uint16:
        return (values >> 8).astype(np.uint8)
    if kind.kind != "f":
        low, high = values.min(), values.max()
        if kind.kind in "iu" and low >= 0 and 1 < high <= 255:
            return np.ascontiguousarray(values.astype(np.uint8))
        raise InputError(
            f"{label} has values of {kind} from {low} to {high}; expected {EXPECTED}."
        )
    if not np.isfinite(values).all():
        raise InputError(f"{label} has values that are not finite (NaN or infinite).")
    low, high = float(values.min()), float(values.max())
    if low < -1e-3 or high > 1 + 1e-3:
        way_out = "divide by 255" if high > 2 and low >= 0 else "bring them to [0, 1]"
        raise InputError(f"{label} has floats from {low:.4g} to {high:.4g}; {way_out}.")
    return np.rint(255 * values.clip(0, 1)).astype(np.uint8)


def _kind(value: Any) -> str:
    return "nothing (None)" if value is None else type(value).__name__
