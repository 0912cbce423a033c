"""The PLY container: header, and the vertex element as a structured array. What the columns mean is `ply`'s part."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edit3r.errors import InputError

MOST_HEADER_BYTES = 1 << 20

_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2"},
    **{"uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


@dataclass(frozen=True)
class PlyHeader:
    """Where a PLY's vertices lie and what columns they have."""

    path: Path
    format: str  # ascii, binary_little_endian or binary_big_endian
    comments: tuple[str, ...]
    count: int  # of vertices
    columns: tuple[tuple[str, str], ...]  # (name, numpy type without byte order)
    offset: int  # of the first vertex [bytes]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.columns)

    def read_vertices(self) -> np.ndarray:
        """Structured array of `count` vertices. Raises InputError when the file ends too soon."""
        order = _BYTE_ORDERS[self.format]
        dtype = np.dtype([(name, order + kind) for name, kind in self.columns])
        if self.format == "ascii":
            return self._read_ascii(dtype)
        available = max(0, os.path.getsize(self.path) - self.offset) // dtype.itemsize
        if available < self.count:
            raise InputError(
                f"{self.path}: cut off, the header promises {self.count} Gaussians, {available} are there."
            )
        return np.fromfile(self.path, dtype, self.count, offset=self.offset)

    def _read_ascii(self, dtype: np.dtype) -> np.ndarray:
        with self.path.open("rb") as file:
            file.seek(self.offset)
            rows = [row for _, row in zip(range(self.count), file)]
        try:
            values = np.array([row.split() for row in rows], dtype=np.float64).reshape(-1, len(self.columns))
        except ValueError:
            raise InputError(f"{self.path}: a row does not hold {len(self.columns)} numbers.") from None
        if len(values) < self.count:
            raise InputError(
                f"{self.path}: cut off, the header promises {self.count} Gaussians, {len(values)} are there."
            )
        table = np.empty(self.count, dtype)
        for column, name in enumerate(self.names):
            table[name] = values[:, column]
        return table


def read_header(path: Path) -> PlyHeader:
    """Read up to `end_header`. The vertex element must come first and hold no lists. Raises InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    try:
        with path.open("rb") as file:
            start = file.read(MOST_HEADER_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from None
    if not start.startswith((b"ply\n", b"ply\r")):
        raise InputError(f"{path}: not a PLY file.")
    for end in (b"\nend_header\n", b"\nend_header\r\n"):
        if end in start:
            text, _, _ = start.partition(end)
            return _parse(path, text.decode("utf-8", "replace").splitlines()[1:], len(text) + len(end))
    raise InputError(f"{path}: a PLY without the end of its header; it is cut off or damaged.")


def _parse(path: Path, lines: list[str], offset: int) -> PlyHeader:
    layout, comments, count, columns, element = "", [], None, [], ""
    for line in lines:
        word, _, rest = line.strip().partition(" ")
        fields = rest.split()
        if word == "comment":
            comments.append(rest)
        elif word == "format" and fields:
            layout = fields[0]
        elif word == "element" and len(fields) == 2:
            if count is None and fields[0] != "vertex":
                raise InputError(f"{path}: its first element is {fields[0]!r}, expected 'vertex'.")
            element = fields[0]
            if element == "vertex":
                count = _whole_number(path, fields[1])
        elif word == "property" and element == "vertex":
            if len(fields) != 2 or fields[0] not in _TYPES:
                raise InputError(f"{path}: a vertex property of an unknown type: {line.strip()!r}.")
            columns.append((fields[1], _TYPES[fields[0]]))
    if layout not in _BYTE_ORDERS or count is None or not columns:
        raise InputError(f"{path}: a PLY header without a known format or without vertices.")
    if len({name for name, _ in columns}) < len(columns):
        raise InputError(f"{path}: two vertex properties have the same name.")
    return PlyHeader(path, layout, tuple(comments), count, tuple(columns), offset)


def _whole_number(path: Path, text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise InputError(f"{path}: expected a number of vertices, got {text!r}.")
    return int(text)
