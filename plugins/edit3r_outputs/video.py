"""Images to a video that browsers play: WebM with VP8 (RFC 6386), every frame a key frame.

Pillow does the coding: the payload of a lossy WebP image *is* a VP8 key frame, so a video is those
payloads in a WebM container. That needs no encoder with a GPL or patent licence, takes less than a
fifth of the time of OpenCV's VP8 and a twentieth of its VP9, gives the same bytes every time, and
can be stopped and stepped at any frame; files are larger by three quarters.
"""

import io
import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.kit.photos.images import to_bytes

QUALITY = 85  # of WebP; about 37 dB on photos
# of WebP, 0 to 6; with 2, files are smaller by 13 % and 0.3 dB worse for one and a half times the
# time
EFFORT = 0
LARGEST_SIDE = 16383  # [pixels], VP8's limit
# block times are 16-bit milliseconds within their cluster, and seeking goes by clusters
CLUSTER_MS = 1000
_EBML, _SEGMENT, _INFO, _TRACKS, _CUES, _CLUSTER = (
    *(0x1A45DFA3, 0x18538067, 0x1549A966),
    *(0x1654AE6B, 0x1C53BB6B, 0x1F43B675),
)
_KEY_FRAME = 0x80

Picture = Float[Tensor, "3 height width"] | UInt8[np.ndarray, "height width 3"]


class VideoWriter(Writer):
    """A flight around the scene as WebM."""

    needs = ("frames",)

    class Settings(edit3r.Settings):
        fps: float = Field(18, gt=0, le=1000)
        """frames per second"""

    settings: Settings

    def write(self, path: Path, scene: SceneToWrite) -> None:
        assert scene.frames is not None  # it is needed
        save_video(path, scene.frames(), self.settings.fps)


def save_video(path: str | Path, frames: Iterable[Picture], fps: float = 24) -> None:
    """Write `frames` of one size (sRGB, clipped to [0, 1], or bytes) as a .webm video with colour
    at half resolution.

    Raises InputError for another suffix, no frames, or frames that VP8 cannot hold.
    """
    path = Path(path)
    if path.suffix.lower() != ".webm":
        raise InputError(f"{path}: videos are written as .webm.")
    if not 0 < fps <= 1000:
        raise InputError(
            f"{path}: expected above 0 and at most 1000 frames per second, got {fps}."
        )
    sizes: set[tuple[int, int]] = set()

    def image_of(frame: Picture) -> Image.Image:
        pixels = frame if isinstance(frame, np.ndarray) else to_bytes(frame)
        image = Image.fromarray(pixels)
        sizes.add(image.size)
        if len(sizes) > 1 or max(image.size) > LARGEST_SIDE:
            raise InputError(
                f"{path}: the frames of a video must share one size of at most {LARGEST_SIDE} "
                "pixels."
            )
        return image

    # coding runs outside the GIL, while the next frames are drawn
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        coded = list(pool.map(_vp8_frame, (image_of(frame) for frame in frames)))
    if not coded:
        raise InputError(f"{path}: a video needs at least one frame.")
    path.write_bytes(_webm(coded, sizes.pop(), fps))


def _vp8_frame(image: Image.Image) -> bytes:
    """The VP8 bit stream in a WebP: RIFF, size, WEBP, then chunks of name, size, padded data."""
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=QUALITY, method=EFFORT)
    data = buffer.getvalue()
    start = 12
    while start < len(data):
        name = data[start : start + 4]
        size = int.from_bytes(data[start + 4 : start + 8], "little")
        if name == b"VP8 ":
            return data[start + 8 : start + 8 + size]
        start += 8 + size + size % 2
    raise AssertionError("Pillow wrote a lossy WebP without a VP8 chunk")


def _webm(frames: Sequence[bytes], size: tuple[int, int], fps: float) -> bytes:
    """A WebM file (RFC 8794 EBML, RFC 9559 Matroska) of VP8 key frames of `size` (width, height)
    [pixels].

    It has one track, and an index for seeking.
    """
    times = [round(1000 * i / fps) for i in range(len(frames) + 1)]
    info = _element(
        _INFO,
        _unsigned(0x2AD7B1, 1_000_000),  # time unit: 1 ms in ns
        _element(0x4489, struct.pack(">d", times[-1])),  # duration
        _element(0x4D80, b"edit3r"),  # muxing and writing application
        _element(0x5741, b"edit3r"),
    )
    tracks = _element(_TRACKS, _track(size, fps))
    clusters = list(_clusters(frames, times))
    # The index stands before what it points to; its own size is known because positions have a
    # fixed width.
    start = len(info) + len(tracks) + len(_cues(clusters, 0))
    data = b"".join(data for _, data in clusters)
    body = info + tracks + _cues(clusters, start) + data
    return _header() + _element(_SEGMENT, body)


def _header() -> bytes:
    names = 0x4286, 0x42F7, 0x42F2, 0x42F3, 0x4287, 0x4285
    versions = zip(names, (1, 1, 4, 8, 2, 2))
    parts = [_unsigned(name, value) for name, value in versions]
    parts.insert(4, _element(0x4282, b"webm"))
    return _element(_EBML, *parts)


def _track(size: tuple[int, int], fps: float) -> bytes:
    width, height = size
    return _element(
        0xAE,
        _unsigned(0xD7, 1),  # number
        _unsigned(0x73C5, 1),  # identity
        _unsigned(0x83, 1),  # video
        _unsigned(0x9C, 0),  # no lacing
        _element(0x86, b"V_VP8"),
        _unsigned(0x23E383, round(1e9 / fps)),  # duration of a frame [ns]
        _element(0xE0, _unsigned(0xB0, width), _unsigned(0xBA, height)),
    )


def _clusters(
    frames: Sequence[bytes], times: Sequence[int]
) -> Iterator[tuple[int, bytes]]:
    """(time, element) of runs of frames that start within one `CLUSTER_MS`."""
    first = 0
    for index in range(1, len(frames) + 1):
        if index == len(frames) or times[index] - times[first] >= CLUSTER_MS:
            start, run = times[first], range(first, index)
            blocks = [_block(frames[i], times[i] - start) for i in run]
            yield start, _element(_CLUSTER, _unsigned(0xE7, start), *blocks)
            first = index


def _block(frame: bytes, time: int) -> bytes:
    return _element(0xA3, b"\x81", struct.pack(">hB", time, _KEY_FRAME), frame)


def _cues(clusters: Sequence[tuple[int, bytes]], start: int) -> bytes:
    """Index of the clusters, which begin `start` bytes into the segment."""
    points = []
    for time, data in clusters:
        place = _element(0xF1, struct.pack(">Q", start))
        position = _element(0xB7, _unsigned(0xF7, 1), place)
        points.append(_element(0xBB, _unsigned(0xB3, time), position))
        start += len(data)
    return _element(_CUES, *points)


def _unsigned(name: int, value: int) -> bytes:
    return _element(name, value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big"))


def _element(name: int, *parts: bytes) -> bytes:
    """Identity, length as an 8-byte EBML number, content."""
    content = b"".join(parts)
    identity = name.to_bytes((name.bit_length() + 7) // 8, "big")
    return identity + struct.pack(">Q", 1 << 56 | len(content)) + content
