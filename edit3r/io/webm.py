"""A minimal WebM writer (RFC 8794 EBML, RFC 9559 Matroska): one VP8 track of key frames, with an index for seeking."""

import struct
from collections.abc import Iterator, Sequence

CLUSTER_MS = 1000  # block times are 16-bit milliseconds within their cluster, and seeking goes by clusters

_EBML, _SEGMENT, _INFO, _TRACKS, _CUES, _CLUSTER = (
    *(0x1A45DFA3, 0x18538067, 0x1549A966),
    *(0x1654AE6B, 0x1C53BB6B, 0x1F43B675),
)
_KEY_FRAME = 0x80


def webm(frames: Sequence[bytes], size: tuple[int, int], fps: float) -> bytes:
    """A whole file of VP8 key frames of `size` (width, height) [pixels]."""
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
    # The index stands before what it points to; its own size is known because positions have a fixed width.
    start = len(info) + len(tracks) + len(_cues(clusters, 0))
    body = info + tracks + _cues(clusters, start) + b"".join(data for _, data in clusters)
    return _header() + _element(_SEGMENT, body)


def _header() -> bytes:
    versions = ((0x4286, 1), (0x42F7, 1), (0x42F2, 4), (0x42F3, 8), (0x4287, 2), (0x4285, 2))
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


def _clusters(frames: Sequence[bytes], times: Sequence[int]) -> Iterator[tuple[int, bytes]]:
    """(time, element) of runs of frames that start within one `CLUSTER_MS`."""
    first = 0
    for index in range(1, len(frames) + 1):
        if index == len(frames) or times[index] - times[first] >= CLUSTER_MS:
            blocks = [_block(frames[i], times[i] - times[first]) for i in range(first, index)]
            yield times[first], _element(_CLUSTER, _unsigned(0xE7, times[first]), *blocks)
            first = index


def _block(frame: bytes, time: int) -> bytes:
    return _element(0xA3, b"\x81", struct.pack(">hB", time, _KEY_FRAME), frame)


def _cues(clusters: Sequence[tuple[int, bytes]], start: int) -> bytes:
    """Index of the clusters, which begin `start` bytes into the segment."""
    points = []
    for time, data in clusters:
        position = _element(0xB7, _unsigned(0xF7, 1), _element(0xF1, struct.pack(">Q", start)))
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
