"""A scene's file with some Gaussians recoloured, taken out or added, all else as it was.

Formats whose colours stand alone (PLY, compressed PLY, SPZ to version 3, splat) are changed where
the colours stand: every other byte of their content stays.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.harmonics import DC
from edit3r.kit.scenes.axes import drawable
from edit3r.kit.scenes.ply import PlyHeader, from_table, read_header, to_table
from edit3r.kit.scenes.reading import form_of
from edit3r.kit.scenes.spz_header import GZIP

CHUNK = 256  # Gaussians of a compressed PLY that share bounds
SPZ_COLOUR = 0.15  # of a constant harmonic, in an SPZ's shares of a byte
_PLAIN = ("f_dc_0", "f_dc_1", "f_dc_2")
_BYTES = ("red", "green", "blue")
_BOUNDS = ("min_r", "min_g", "min_b", "max_r", "max_g", "max_b")


@dataclass(frozen=True)
class SceneChange:
    """What becomes of the Gaussians of a file, in the order in which it is read."""

    kept: Bool[np.ndarray, "gaussian"]
    changed: Bool[np.ndarray, "gaussian"]  # whose colours are others
    plain: Float[np.ndarray, "changed 3"]  # constant harmonics of these
    # the colours [new, old] that their other harmonics take on
    shine: Float[np.ndarray, "3 3"]
    added: Gaussians | None = None  # at the end, in the file's frame

    @property
    def keeps_all(self) -> bool:
        return bool(self.kept.all()) and self.added is None

    @property
    def keeps_shine(self) -> bool:
        return bool((self.shine == np.eye(3)).all())


def rewritten(source: Path, change: SceneChange) -> bytes | None:
    """The content of the file with the change; None for a format whose bytes hang together."""
    form = form_of(source)
    if form == "ply":
        return _ply(source, change)
    if not change.keeps_all:
        return None
    if form == "compressed.ply":
        return _compressed_ply(source, change)
    if form == "splat":
        return _splat(source.read_bytes(), change)
    content = source.read_bytes()
    if form == "spz" and content.startswith(GZIP):
        return _spz(content, change)
    return None


# PLY


def _ply(source: Path, change: SceneChange) -> bytes | None:
    header = read_header(source)
    table = header.read_vertices()
    # Rows that no scene can hold are not among the Gaussians, and stay.
    rows = drawable(from_table(table, header)).numpy().nonzero()[0]
    if len(rows) != len(change.kept):
        return None
    content = source.read_bytes()
    start = content[: header.offset]
    if header.format == "ascii":
        return _text_ply(content, start, header, table, rows, change)
    body = table.copy()
    _recolour(body, rows[change.changed], change)
    rest = content[header.offset + table.nbytes :]
    stays = np.ones(len(table), bool)
    stays[rows[~change.kept]] = False
    parts = [body[stays].tobytes()]
    if change.added is not None:
        parts.append(_added(change.added, body.dtype).tobytes())
    count = sum(len(part) for part in parts) // body.dtype.itemsize
    return b"".join((_with_count(start, len(table), count), *parts, rest))


def _recolour(table: np.ndarray, rows: np.ndarray, change: SceneChange) -> None:
    """Set the colours of `rows` of a table of vertices."""
    names = table.dtype.names or ()
    if _PLAIN[0] in names:
        for name, values in zip(_PLAIN, change.plain.T):
            table[name][rows] = values
    else:
        whole = np.issubdtype(table.dtype[_BYTES[0]], np.integer)
        colours = (change.plain * DC + 0.5).clip(0, 1) * (255 if whole else 1)
        for name, values in zip(_BYTES, colours.T):
            table[name][rows] = values.round() if whole else values
    further = sum(name.startswith("f_rest_") for name in names) // 3
    if further and not change.keeps_shine:
        of_channel = [
            [f"f_rest_{channel * further + one}" for one in range(further)]
            for channel in range(3)
        ]
        old = np.stack([[table[n][rows] for n in some] for some in of_channel])
        new = np.einsum("dc,c...->d...", change.shine, old.astype(np.float64))
        for some, values in zip(of_channel, new):
            for name, column in zip(some, values):
                table[name][rows] = column


def _added(gaussians: Gaussians, dtype: np.dtype) -> np.ndarray:
    """More rows of a table; what other programs keep of a Gaussian is 0."""
    given = to_table(gaussians, gaussians.degree)
    rows = np.zeros(len(given), dtype)
    for name in dtype.names or ():
        if name in (given.dtype.names or ()):
            rows[name] = given[name]
    return rows


def _with_count(start: bytes, before: int, after: int) -> bytes:
    """A PLY's header with another number of vertices."""
    lines = start.split(b"\n")
    place = next(i for i, line in enumerate(lines) if line.startswith(b"element "))
    lines[place] = lines[place].replace(b"%d" % before, b"%d" % after)
    return b"\n".join(lines)


def _text_ply(
    content: bytes,
    start: bytes,
    header: PlyHeader,
    table: np.ndarray,
    rows: np.ndarray,
    change: SceneChange,
) -> bytes:
    lines = content[len(start) :].splitlines(keepends=True)
    body = table.copy()
    _recolour(body, rows[change.changed], change)
    for row in rows[change.changed]:
        words = lines[row].split()
        for place, name in enumerate(header.names):
            if body[name][row] != table[name][row]:
                words[place] = b"%.9g" % body[name][row]
        ending = lines[row][len(lines[row].rstrip()) :]
        lines[row] = b" ".join(words) + ending
    gone = set(rows[~change.kept].tolist())
    stays = [line for row, line in enumerate(lines) if row not in gone]
    new: list[bytes] = []
    if change.added is not None:
        more = _added(change.added, body.dtype).tolist()
        new = [b" ".join(b"%.9g" % value for value in one) + b"\n" for one in more]
    vertices = header.count - len(gone)
    stays[vertices:vertices] = new
    return _with_count(start, header.count, vertices + len(new)) + b"".join(stays)


# Compressed PLY


def _compressed_ply(source: Path, change: SceneChange) -> bytes | None:
    content = bytearray(source.read_bytes())
    offset, elements = _elements(bytes(content))
    tables = {}
    for name, count, dtype in elements:
        tables[name] = np.frombuffer(content, dtype, count, offset)
        offset += count * dtype.itemsize
    vertices, chunks = tables["vertex"], tables["chunk"]
    if len(vertices) != len(change.kept):
        return None
    packed = vertices["packed_color"]
    levels = np.stack([packed >> shift & 255 for shift in (24, 16, 8)], 1) / 255.0
    chunk_of = np.arange(len(vertices)) // CHUNK
    if set(_BOUNDS) <= set(chunks.dtype.names or ()):
        low, high = (
            np.stack([chunks[name] for name in some], 1).astype(np.float64)
            for some in (_BOUNDS[:3], _BOUNDS[3:])
        )
    else:
        low, high = np.zeros((len(chunks), 3)), np.ones((len(chunks), 3))
    colours = low[chunk_of] + levels * (high - low)[chunk_of]
    wanted = change.plain.astype(np.float64) * DC + 0.5
    colours[change.changed] = wanted
    rows = change.changed.nonzero()[0]
    # Bounds that new colours leave become wider, and all of their chunk is counted anew.
    if set(_BOUNDS) <= set(chunks.dtype.names or ()):
        outside = (wanted < low[chunk_of[rows]]) | (wanted > high[chunk_of[rows]])
        wider = np.unique(chunk_of[rows[outside.any(1)]])
        np.minimum.at(low, chunk_of[rows], wanted)
        np.maximum.at(high, chunk_of[rows], wanted)
        for end, name in zip((*low.T, *high.T), _BOUNDS):
            chunks[name][wider] = end[wider]
        rows = np.union1d(rows, np.isin(chunk_of, wider).nonzero()[0])
    spread = np.maximum((high - low)[chunk_of[rows]], 1e-12)
    shares = (colours[rows] - low[chunk_of[rows]]) / spread
    red, green, blue = (shares.clip(0, 1) * 255).round().astype(np.uint32).T
    packed[rows] = red << 24 | green << 16 | blue << 8 | packed[rows] & 255
    if "sh" in tables and not change.keeps_shine:
        _shine_of_bytes(tables["sh"], change)
    return bytes(content)


def _elements(content: bytes) -> tuple[int, list[tuple[str, int, np.dtype]]]:
    """Where the elements of a binary little-endian PLY begin, and the columns of each."""
    kinds = {"float": "<f4", "uint": "<u4", "uchar": "u1", "int": "<i4"}
    head, _, _ = content.partition(b"end_header")
    offset = content.index(b"\n", len(head)) + 1
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in head.decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append((words[2], kinds[words[1]]))
    return offset, [(name, count, np.dtype(some)) for name, count, some in elements]


def _shine_of_bytes(table: np.ndarray, change: SceneChange) -> None:
    names = table.dtype.names or ()
    further = len(names) // 3
    rows = change.changed.nonzero()[0]
    old = np.stack([table[name][rows] for name in names]).astype(np.float64)
    values = ((old + 0.5) / 256 - 0.5) * 8
    mixed = np.einsum("dc,cfr->dfr", change.shine, values.reshape(3, further, -1))
    new = ((mixed / 8 + 0.5) * 256).clip(0, 255).reshape(len(names), -1)
    for name, column in zip(names, new):
        table[name][rows] = column.astype(np.uint8)


# Splat and SPZ


def _splat(content: bytes, change: SceneChange) -> bytes | None:
    rows = np.frombuffer(content, np.uint8).reshape(-1, 32).copy()
    if len(rows) != len(change.kept):
        return None
    colours = (change.plain * DC + 0.5).clip(0, 1) * 255
    rows[change.changed, 24:27] = colours.round().astype(np.uint8)
    return rows.tobytes()


def _spz(content: bytes, change: SceneChange) -> bytes | None:
    stream = zlib.decompressobj(wbits=31)
    body = bytearray(stream.decompress(content))
    _, version, count, degree = struct.unpack_from("<4sIIB", body)
    if count != len(change.kept):
        return None
    colours_at = 16 + count * ((6 if version == 1 else 9) + 1)
    values = np.frombuffer(body, np.uint8, 3 * count, colours_at).reshape(-1, 3)
    levels = (change.plain * SPZ_COLOUR + 0.5).clip(0, 1) * 255
    values[change.changed] = levels.round().astype(np.uint8)
    further = (degree + 1) ** 2 - 1
    if further and not change.keeps_shine:
        shine_at = colours_at + count * (6 + (3 if version < 3 else 4))
        size = 3 * further * count
        shine = np.frombuffer(body, np.uint8, size, shine_at).reshape(count, -1, 3)
        old = (shine[change.changed].astype(np.float64) - 128) / 128
        new = old @ change.shine.T * 128 + 128
        shine[change.changed] = new.round().clip(0, 255).astype(np.uint8)
    packer = zlib.compressobj(9, wbits=-15)
    packed = packer.compress(bytes(body)) + packer.flush()
    checks = struct.pack("<II", zlib.crc32(body), len(body) & 0xFFFFFFFF)
    return content[: _gzip_header(content)] + packed + checks


def _gzip_header(content: bytes) -> int:
    """The bytes before the packed data of a gzip stream (RFC 1952)."""
    flags, place = content[3], 10
    if flags & 4:
        place += 2 + int.from_bytes(content[place : place + 2], "little")
    for flag in (8, 16):  # a name and a comment, which end with 0
        if flags & flag:
            place = content.index(b"\0", place) + 1
    return place + (2 if flags & 2 else 0)
