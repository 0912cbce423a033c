"""What the header of an SPZ says: version, number of Gaussians, axes; and whether it is whole.

The format: https://github.com/nianticlabs/spz. Versions 1 to 3 are one gzip stream, version 4 has a
plain header of 32 bytes and streams of zstd. Its axes are x right, y up, z backward, unless an
extension names others.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import torch

from edit3r.contract.errors import InputError
from edit3r.contract.types import MAX_DEGREE, Gaussians
from edit3r.kit.scenes.axes import flipped, rotated

GZIP = b"\x1f\x8b"
_MAGIC = b"NGSP"
_HAS_EXTENSIONS = 2  # flag
_AXES = 0xADBE0003  # number of the extension SPZ_ADOBE_coordinate_system
_USUAL = 4  # right, up, back
_MOST_EXTENSIONS = 1 << 16  # bytes
_Y_AND_Z = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From x right, y forward, z up to x right, y down, z forward."""


@dataclass(frozen=True)
class SpzHeader:
    """What an SPZ says of itself."""

    version: int
    count: int  # of Gaussians
    axes: int = _USUAL  # from 1, as the extension numbers them: LDB RDB LUB RUB LDF RDF LUF RUF,
    # then the same with y and z exchanged

    def upright(self, gaussians: Gaussians) -> Gaussians:
        """The scene as it stands in the file, in our axes."""
        bits = [(self.axes - 1 >> bit & 1) * 2.0 - 1 for bit in range(3)]
        right, up, last = bits
        if self.axes <= 8:  # y up or down, z forward (the last bit) or back
            return flipped(gaussians, (right, -up, last))
        # y back (the last bit) or forward, z up or down
        return rotated(flipped(gaussians, (right, -last, up)), _Y_AND_Z)


def read_spz_header(path: Path) -> SpzHeader:
    """Raises InputError for a file that is cut off, or promises more than it holds."""
    content = path.read_bytes()
    try:
        return _packed(content) if content.startswith(GZIP) else _plain(content)
    except (ValueError, struct.error, zlib.error) as error:
        raise InputError(
            f"{path}: a damaged SPZ ({error}); copy or export it again."
        ) from None


def _packed(content: bytes) -> SpzHeader:
    """Of versions 1 to 3: the body is unpacked in pieces, and none is kept."""
    stream = zlib.decompressobj(wbits=31)
    start = stream.decompress(content, 16)
    magic, version, count, degree, _, flags, _ = struct.unpack_from("<4sIIBBBB", start)
    if magic != _MAGIC or version not in (1, 2, 3):
        raise ValueError(f"version {version}")
    left = count * _bytes_of_one(version, degree)
    while left > 0:
        piece = stream.decompress(stream.unconsumed_tail, min(left, 1 << 22))
        if not piece:
            raise ValueError("it is cut off")
        left -= len(piece)
    rest = b""
    if flags & _HAS_EXTENSIONS:
        rest = stream.decompress(stream.unconsumed_tail, _MOST_EXTENSIONS)
    return SpzHeader(version, count, _axes(rest))


def _plain(content: bytes) -> SpzHeader:
    """Of version 4."""
    magic, version, count, degree, _, flags, streams, begin = struct.unpack_from(
        "<4sIIBBBBI", content
    )
    if magic != _MAGIC or version != 4:
        raise ValueError(f"version {version}")
    sizes = struct.unpack_from(f"<{2 * streams}Q", content, begin)
    if begin + 16 * streams + sum(sizes[::2]) > len(content):
        raise ValueError("it is cut off")
    if sum(sizes[1::2]) != count * _bytes_of_one(version, degree):
        raise ValueError("its parts are not of the size that its header promises")
    return SpzHeader(
        version, count, _axes(content[32:begin] if flags & _HAS_EXTENSIONS else b"")
    )


def _bytes_of_one(version: int, degree: int) -> int:
    if degree > MAX_DEGREE:
        raise ValueError(f"harmonics of degree {degree}")
    position, rotation = (6 if version == 1 else 9), (3 if version < 3 else 4)
    return position + rotation + 7 + 3 * ((degree + 1) ** 2 - 1)


def _axes(records: bytes) -> int:
    """The axes that the extensions name; the usual ones where they name none."""
    while len(records) >= 12:
        kind, length, value = struct.unpack_from("<III", records)
        if kind == _AXES:
            if value > 16:
                raise ValueError(f"axes of number {value}")
            return value or _USUAL
        records = records[8 + length :]
    return _USUAL
