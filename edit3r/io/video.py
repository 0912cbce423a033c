"""Pictures to a video that browsers play: WebM with VP8 (RFC 6386), every frame a key frame.

Pillow does the coding: the payload of a lossy WebP picture *is* a VP8 key frame, so a video is those payloads in a WebM
container. That needs no encoder with a GPL or patent licence, takes less than a fifth of the time of OpenCV's VP8 and a
twentieth of its VP9, gives the same bytes every time, and can be stopped and stepped at any frame; files are larger by
three quarters.
"""

import io
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.images import to_bytes
from edit3r.io.run_folder import atomic_write
from edit3r.io.webm import webm

QUALITY = 85  # of WebP; about 37 dB on photos
EFFORT = 0  # of WebP, 0 to 6; with 2, files are smaller by 13 % and 0.3 dB worse for one and a half times the time
LARGEST_SIDE = 16383  # [pixels], VP8's limit


Frame = Float[Tensor, "3 height width"] | UInt8[np.ndarray, "height width 3"]


def save_video(path: str | Path, frames: Iterable[Frame], fps: float = 24) -> None:
    """Write `frames` of one size (sRGB, clipped to [0, 1], or bytes) as a .webm video with colour at half resolution.

    Raises InputError for another suffix, no frames, or frames that VP8 cannot hold.
    """
    path = Path(path)
    if path.suffix.lower() != ".webm":
        raise InputError(f"{path}: videos are written as .webm.")
    if not 0 < fps <= 1000:
        raise InputError(f"{path}: expected above 0 and at most 1000 frames per second, got {fps}.")
    pictures = [Image.fromarray(frame if isinstance(frame, np.ndarray) else to_bytes(frame)) for frame in frames]
    if not pictures:
        raise InputError(f"{path}: a video needs at least one frame.")
    size = pictures[0].size
    if any(picture.size != size for picture in pictures) or max(size) > LARGEST_SIDE:
        raise InputError(f"{path}: the frames of a video must share one size of at most {LARGEST_SIDE} pixels.")
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # coding runs outside the GIL
        content = webm(list(pool.map(_vp8_frame, pictures)), size, fps)
    with atomic_write(path) as partial:
        partial.write_bytes(content)


def _vp8_frame(picture: Image.Image) -> bytes:
    """The VP8 bit stream inside a WebP file: RIFF, size, WEBP, then chunks of name, size, data padded to even."""
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", quality=QUALITY, method=EFFORT)
    data = buffer.getvalue()
    start = 12
    while start < len(data):
        name, size = data[start : start + 4], int.from_bytes(data[start + 4 : start + 8], "little")
        if name == b"VP8 ":
            return data[start + 8 : start + 8 + size]
        start += 8 + size + size % 2
    raise AssertionError("Pillow wrote a lossy WebP without a VP8 chunk")
