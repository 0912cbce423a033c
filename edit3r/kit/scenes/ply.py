"""Gaussians as the PLY of 3D Gaussian Splatting, which every splat viewer opens.

One `vertex` element of little-endian float32: x y z, nx ny nz (zero), f_dc_0..2, f_rest_*
(channel-major: all of red, then green, then blue), opacity (logit), scale_0..2 (log), rot_0..3
(wxyz). A scene with objects has one more: object_index (-1: none); one whose uncertainty was
estimated has uncertainty (in [0, 1]). The header's comments say in which frame.
"""

import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say, warn
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import MAX_DEGREE, Gaussians
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.geometry.harmonics import DC
from edit3r.kit.scenes.axes import SHORTEST_QUAT, sound

__all__ = [
    "MOST_HEADER_BYTES",
    "SMALLEST_SCALE",
    "VIEWER_DEGREE",
    "load_ply",
    "save_ply",
]

OPACITY_MARGIN = 1e-7  # keeps the logits of 0 and 1 finite, within +-16.2
SMALLEST_SCALE = float(np.finfo(np.float32).tiny)  # keeps the logarithm of 0 finite
VIEWER_DEGREE = 3  # common viewers read harmonics up to here
OBJECT = "object_index"  # property of scenes with objects
UNCERTAINTY = "uncertainty"  # property of scenes in which it was estimated
# Whole numbers up to here are exact in float32, and no other one comes out as one of them.
MAX_OBJECT = (1 << 24) - 1
MOST_RUNS = 256  # of equal view_index that the header keeps

_FRAME = "frame: camera of view 0, OpenCV axes (x right, y down, z forward), camera at the origin"
_VIEWS = "view_index runs (view:count)"
_RUN = re.compile(r"(-1|[0-9]{1,9}):([0-9]{1,12})")
_REQUIRED = (
    *("x", "y", "z", "opacity", "scale_0"),
    *("rot_0", "rot_1", "rot_2", "rot_3"),
)
_PLAIN = ("f_dc_0", "f_dc_1", "f_dc_2")
_COLOURS = ("red", "green", "blue")  # of scenes without harmonics: bytes, or shares
_FILTER = "filter_3D"  # of Mip-Splatting: a standard deviation that is to be added to the sizes
_NOT_SHOWN = re.compile(r"n[xyz]|alpha|f_rest_\d+|scale_[12]")  # beside the above
_LONG_NAMES = 100  # characters of properties that a warning names

MOST_HEADER_BYTES = 1 << 20
# characters of one comment: a header beyond `MOST_HEADER_BYTES` is not read again
MOST_COMMENT = 1000
SPREAD = 3.0  # distances of neighbours that a usual Gaussian does not cover
COARSE = 0.5  # of a Gaussian's size: steps between places that spoil a scene
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_ASCII = "ascii"


@in_usual_torch
def save_ply(
    path: str | Path,
    gaussians: Gaussians,
    *,
    degree: int | None = None,
    comment_lines: Sequence[str] = (),
) -> None:
    """Write one scene (batch 1); the same Gaussians give the same bytes. Raises InputError for
    Gaussians that a PLY cannot hold.

    All harmonics are written. Common viewers stop at degree 3 (some refuse more): `degree` cuts to
    that many, which loses the finest change of colour with direction. `view_index` goes into the
    header as runs of equal values, where no viewer stumbles over it; more than 256 runs are not
    kept. Opacities 0 and 1 come back as 1e-7 and 1 - 1e-7.
    """
    if gaussians.means.shape[0] != 1:
        raise InputError(
            f"{path}: a PLY holds one scene, got a batch of {gaussians.means.shape[0]}; save "
            "them one by one."
        )
    degree = gaussians.degree if degree is None else min(degree, gaussians.degree)
    if degree > VIEWER_DEGREE:
        warn(
            f"{path}: harmonics of degree {degree}; many viewers read {VIEWER_DEGREE} at most."
        )
    if gaussians.object_index is not None and gaussians.objects.max() > MAX_OBJECT:
        raise InputError(
            f"{path}: object_index goes up to {int(gaussians.objects.max())}; a PLY holds "
            f"{MAX_OBJECT} at most."
        )
    table = to_table(gaussians, degree)
    if not all(np.isfinite(table[name]).all() for name in table.dtype.names or ()):
        raise InputError(f"{path}: the Gaussians hold values that are not finite.")
    comments = [
        "3D Gaussians by edit3r",
        _FRAME,
        *_view_runs(gaussians.view_index.cpu().numpy()),
        *comment_lines,
    ]
    with atomic_write(path) as partial, partial.open("wb") as file:
        file.write(_header(table, comments))
        file.write(table.data)


@in_usual_torch
def load_ply(path: str | Path, *, visible: bool = False) -> Gaussians:
    """Read a 3DGS PLY (binary or text, any number type) as one scene on the CPU.

    Degree 0 to 4, or colours alone; two scales are those of flat discs, one that of balls. The 3D
    filter of Mip-Splatting is worked in, sizes that cannot be logarithms are taken as lengths, and
    further properties are passed over, each with a remark. Quaternions come back normalised;
    Gaussians with values that are not finite are left out with a warning. Raises InputError for a
    file that is no such PLY, or is cut off; with `visible` also for a scene in which nothing can be
    drawn.
    """
    path = Path(path)
    header = read_header(path)
    plain = _COLOURS if {*_COLOURS} <= {*header.names} - {*_PLAIN} else _PLAIN
    missing = [name for name in (*_REQUIRED, *plain) if name not in header.names]
    if missing:
        raise InputError(
            f"{path}: this PLY does not hold 3D Gaussians, it lacks {', '.join(missing)}."
        )
    _tell_unknown(header)
    gaussians = from_table(header.read_vertices(), header)
    gaussians = sound(path, gaussians, visible=visible)
    if gaussians.count:
        _tell_coarse(path, gaussians)
    return gaussians


def _tell_unknown(header: "PlyHeader") -> None:
    """Warn of properties that may change how another program shows the scene."""
    known = {*_REQUIRED, *_PLAIN, *_COLOURS, _FILTER, OBJECT, UNCERTAINTY}
    names = [n for n in header.names if n not in known and not _NOT_SHOWN.fullmatch(n)]
    if names:
        listed = ", ".join(names)
        if len(listed) > _LONG_NAMES:
            listed = f"{listed[:_LONG_NAMES]}... ({len(names)} in all)"
        warn(
            f"{header.path}: has properties that are not known here and are passed over: {listed}; "
            "where they change its look, export it from its own program first."
        )


def _tell_coarse(path: Path, gaussians: Gaussians) -> None:
    """Warn of a scene so far from the origin, as in a country's coordinates, that numbers of 32
    bits do not tell its Gaussians apart.
    """
    middle = gaussians.means[0].abs().amax(1).median()
    step = float(middle) * torch.finfo(torch.float32).eps
    size = float(gaussians.scales.median())
    if step > COARSE * size:
        warn(
            f"{path}: lies {float(middle):.3g} from the origin, where places are {step:.2g} apart "
            f"and Gaussians {size:.2g} large; move it to the origin before it is saved as PLY."
        )


def to_table(gaussians: Gaussians, degree: int) -> np.ndarray:
    """Structured array of the vertex element; logits and logarithms in double precision."""
    coefficients = (degree + 1) ** 2
    quats = gaussians.quats[0].detach().double()
    without = quats.norm(dim=-1, keepdim=True) <= SHORTEST_QUAT
    quats = torch.where(without, quats.new_tensor((1.0, 0, 0, 0)), quats)
    opacities = (
        gaussians.opacities[0]
        .detach()
        .double()
        .clamp(OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    )
    harmonics = gaussians.harmonics[0, :, :coefficients].detach()
    columns = [
        gaussians.means[0].detach(),
        torch.zeros(1, 3).expand(gaussians.count, -1),
        harmonics[:, 0],
        harmonics[:, 1:].transpose(1, 2).flatten(1),  # [G, 3 * (K - 1)]
        torch.logit(opacities)[:, None],
        gaussians.scales[0].detach().double().clamp(min=SMALLEST_SCALE).log(),
        torch.from_numpy(_unit(quats.cpu().numpy())),
    ]
    further = {}
    if gaussians.object_index is not None:
        further[OBJECT] = gaussians.object_index
    if gaussians.uncertainty is not None:
        further[UNCERTAINTY] = gaussians.uncertainty[0].detach()
    columns += [values[:, None] for values in further.values()]
    table = torch.empty(
        gaussians.count, sum(column.shape[1] for column in columns), dtype=torch.float32
    )
    for part, column in zip(
        table.split([column.shape[1] for column in columns], 1), columns
    ):
        part.copy_(column)
    names = [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(3 * (coefficients - 1))),
        "opacity",
        *(f"scale_{axis}" for axis in range(3)),
        *(f"rot_{part}" for part in range(4)),
    ]
    names += further
    return (
        table.numpy()
        .astype("<f4", copy=False)
        .view([(name, "<f4") for name in names])[:, 0]
    )


def _header(table: np.ndarray, comments: Sequence[str]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {_one_line(comment)}" for comment in comments]
    lines += [
        f"element vertex {len(table)}",
        *(f"property float {name}" for name in table.dtype.names or ()),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in lines).encode("ascii", "backslashreplace")


def _one_line(comment: str) -> str:
    line = " ".join(comment.split())
    return (
        line
        if len(line) <= MOST_COMMENT or comment.startswith(_VIEWS)
        else f"{line[:MOST_COMMENT]}..."
    )


def _view_runs(view_index: np.ndarray) -> list[str]:
    if not len(view_index) or (view_index == -1).all():
        return []
    starts = np.concatenate(([0], np.flatnonzero(np.diff(view_index)) + 1))
    if len(starts) > MOST_RUNS:
        return []
    counts = np.diff(np.append(starts, len(view_index)))
    runs = " ".join(
        f"{view}:{count}" for view, count in zip(view_index[starts], counts)
    )
    return [f"{_VIEWS} {runs}"]


def _read_view_runs(header: "PlyHeader") -> Int64[np.ndarray, "gaussian"]:
    """`view_index` from the header's comment; -1 where it does not fit the number of Gaussians."""
    for comment in header.comments:
        if comment.startswith(_VIEWS):
            runs = [_RUN.fullmatch(run) for run in comment.removeprefix(_VIEWS).split()]
            pairs = [(int(run[1]), int(run[2])) for run in runs if run is not None]
            views = np.array([view for view, _ in pairs], dtype=np.int64)
            counts = np.array([count for _, count in pairs], dtype=np.int64)
            if len(pairs) == len(runs) and counts.sum() == header.count:
                return np.repeat(views, counts)
    return np.full(header.count, -1, dtype=np.int64)


def from_table(table: np.ndarray, header: "PlyHeader") -> Gaussians:
    degree = _degree(header)
    rest = (degree + 1) ** 2 - 1  # coefficients per colour above degree 0
    dc = _plain_colours(table, header)[:, None]
    higher = _columns(table, [f"f_rest_{i}" for i in range(3 * rest)]).reshape(
        header.count, 3, rest
    )
    with np.errstate(over="ignore", invalid="ignore"):
        scales, opacities = _filtered(
            _scales(table, header),
            1 / (1 + np.exp(-_columns(table, ("opacity",))[:, 0])),
            table,
            header,
        )
        quats = _columns(table, ("rot_0", "rot_1", "rot_2", "rot_3"))
        columns = {
            "means": _columns(table, ("x", "y", "z")),
            "scales": scales,
            "quats": _unit(quats),
            "opacities": opacities,
            "harmonics": np.concatenate((dc, higher.transpose(0, 2, 1)), 1),
        }
        # Through float32 first: what is finite in double may not be afterwards.
        tensors = {
            name: torch.from_numpy(values.astype(np.float32))
            for name, values in columns.items()
        }
    return Gaussians(
        **{name: values[None] for name, values in tensors.items()},
        view_index=torch.from_numpy(_read_view_runs(header)),
        object_index=_read_objects(table, header),
        uncertainty=_read_uncertainty(table, header),
    )


def _plain_colours(
    table: np.ndarray, header: "PlyHeader"
) -> Float64[np.ndarray, "gaussian 3"]:
    """The harmonics of degree 0, or those of colours as bytes."""
    if _PLAIN[0] in header.names:
        return _columns(table, _PLAIN)
    whole = dict(header.columns)[_COLOURS[0]].startswith(("u", "i"))
    return (_columns(table, _COLOURS) / (255 if whole else 1) - 0.5) / DC


def _scales(
    table: np.ndarray, header: "PlyHeader"
) -> Float64[np.ndarray, "gaussian axis"]:
    """Three scales: those of a file, or one of a ball; or two, of a disc. A file holds logarithms
    of them; where these would make each Gaussian cover much of the scene, they are lengths.
    """
    names = [name for name in ("scale_0", "scale_1", "scale_2") if name in header.names]
    stored = _columns(table, names)
    scales = np.exp(stored)
    if len(table) and stored.min() > 0:
        places = _columns(table, ("x", "y", "z"))
        extent = np.ptp(np.percentile(places, (5, 95), axis=0), axis=0).max()
        between = extent / math.sqrt(len(table))  # neighbours on a surface
        if np.median(stored) < SPREAD * between < np.median(scales):
            warn(
                f"{header.path}: its sizes cannot be logarithms, as they are in this format; they "
                "are taken as lengths."
            )
            scales = stored
    if len(names) == 2:
        say("scene.flat", "its Gaussians have two scales and are read as flat discs")
        return scales
    return np.broadcast_to(scales, (len(table), 3))


def _filtered(
    scales: Float64[np.ndarray, "gaussian axis"],
    opacities: Float64[np.ndarray, "gaussian"],
    table: np.ndarray,
    header: "PlyHeader",
) -> tuple[Float64[np.ndarray, "gaussian axis"], Float64[np.ndarray, "gaussian"]]:
    """Scales and opacities with Mip-Splatting's 3D filter, which its files leave to viewers."""
    if _FILTER not in header.names:
        return scales, opacities
    say(
        "scene.filter",
        f"its {_FILTER} (Mip-Splatting) is worked into sizes and opacities",
    )
    wide = np.hypot(scales, _columns(table, (_FILTER,)))
    return wide, opacities * np.prod(scales / wide, axis=1)


def _read_objects(
    table: np.ndarray, header: "PlyHeader"
) -> Int64[Tensor, "gaussian"] | None:
    """`object_index` of the Gaussians; what is no index of an object is -1."""
    if OBJECT not in header.names:
        return None
    values = table[OBJECT].astype(np.float64)
    known = (values >= 0) & (values <= MAX_OBJECT)
    lost = int((~known & (values != -1)).sum())
    if lost:
        warn(
            f"{header.path}: {lost} Gaussians have an {OBJECT} that is none, and get none."
        )
    index = np.where(known, values, -1)
    return torch.from_numpy(index.astype(np.int64))


def _read_uncertainty(
    table: np.ndarray, header: "PlyHeader"
) -> Float[Tensor, "1 gaussian"] | None:
    """`uncertainty` of the Gaussians; what is no number is 1."""
    if UNCERTAINTY not in header.names:
        return None
    values = np.nan_to_num(table[UNCERTAINTY].astype(np.float32), nan=1.0).clip(0, 1)
    return torch.from_numpy(values)[None]


def _unit(quats: np.ndarray) -> np.ndarray:
    """Unit quaternions [gaussian, 4]; those that are keep their bits, so files can go round."""
    norms = np.linalg.norm(quats, axis=-1, keepdims=True)
    return np.where(np.abs(norms - 1) < 1e-6, quats, quats / np.maximum(norms, 1e-12))


def _degree(header: "PlyHeader") -> int:
    rest = {name for name in header.names if name.startswith("f_rest_")}
    for degree in range(MAX_DEGREE + 1):
        if rest == {f"f_rest_{i}" for i in range(3 * ((degree + 1) ** 2 - 1))}:
            return degree
    raise InputError(
        f"{header.path}: {len(rest)} f_rest properties; expected 0, 9, 24, 45 or 72 in a row "
        "(degree 0 to 4)."
    )


def _columns(
    table: np.ndarray, names: Sequence[str]
) -> Float64[np.ndarray, "gaussian column"]:
    """The columns called `names`, in double precision."""
    if not names:
        return np.zeros((len(table), 0))
    return np.stack([table[name].astype(np.float64) for name in names], -1)


@dataclass(frozen=True)
class PlyHeader:
    """Where a PLY's vertices lie and what columns they have."""

    path: Path
    format: str  # binary_little_endian, binary_big_endian or ascii
    comments: tuple[str, ...]
    count: int  # of vertices
    columns: tuple[tuple[str, str], ...]  # (name, numpy type without byte order)
    offset: int  # of the first vertex [bytes]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.columns)

    def read_vertices(self) -> np.ndarray:
        """Structured array of `count` vertices. Raises InputError when the file ends too soon."""
        if self.format == _ASCII:
            return self._read_text()
        order = _BYTE_ORDERS[self.format]
        dtype = np.dtype([(name, order + kind) for name, kind in self.columns])
        available = max(0, os.path.getsize(self.path) - self.offset) // dtype.itemsize
        if available < self.count:
            raise InputError(
                f"{self.path}: cut off, the header promises {self.count} Gaussians, {available} "
                "are there."
            )
        return np.fromfile(self.path, dtype, self.count, offset=self.offset)

    def _read_text(self) -> np.ndarray:
        with self.path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a scene without Gaussians
            file.seek(self.offset)
            try:
                numbers = np.loadtxt(
                    file, comments=None, max_rows=max(1, self.count), ndmin=2
                )
            except ValueError as error:
                raise InputError(
                    f"{self.path}: its numbers cannot be read ({error})."
                ) from None
        if numbers.size == 0 or self.count == 0:
            numbers = np.empty((0, len(self.columns)))
        if numbers.shape != (self.count, len(self.columns)):
            raise InputError(
                f"{self.path}: the header promises {self.count} Gaussians of {len(self.columns)} "
                f"numbers, {len(numbers)} of {numbers.shape[1]} are there."
            )
        dtype = np.dtype([(name, "<f8") for name, _ in self.columns])
        return np.ascontiguousarray(numbers).view(dtype)[:, 0]


def read_header(path: Path) -> PlyHeader:
    """Read up to `end_header`; vertices come first and hold no lists. Raises InputError."""
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
            return _parse(
                path,
                text.decode("utf-8", "replace").splitlines()[1:],
                len(text) + len(end),
            )
    raise InputError(
        f"{path}: a PLY without the end of its header; it is cut off or damaged."
    )


def _parse(path: Path, lines: list[str], offset: int) -> PlyHeader:
    layout = ""
    element = ""
    comments: list[str] = []
    counts: dict[str, int] = {}
    columns: list[tuple[str, str]] = []
    for line in lines:
        word, _, rest = line.strip().partition(" ")
        fields = rest.split()
        if word == "comment":
            comments.append(rest)
        elif word == "format" and fields:
            layout = fields[0]
        elif word == "element" and len(fields) == 2:
            element = fields[0]
            counts.setdefault(element, _count(path, counts, *fields))
        elif word == "property" and element == "vertex":
            columns.append(_column(path, fields))
    if layout not in (*_BYTE_ORDERS, _ASCII) or not counts or not columns:
        raise InputError(
            f"{path}: a PLY header without a known format or without vertices."
        )
    if len({name for name, _ in columns}) < len(columns):
        raise InputError(f"{path}: two vertex properties have the same name.")
    return PlyHeader(
        path, layout, tuple(comments), counts["vertex"], tuple(columns), offset
    )


def _count(path: Path, before: Mapping[str, int], element: str, count: str) -> int:
    """How many of an element follow; only the vertices, which come first, are ever read."""
    if not before and element != "vertex":
        raise InputError(
            f"{path}: its first element is {element!r}, expected 'vertex'; a compressed PLY "
            "is made a plain one by: edit3r export FILE --to ply."
        )
    if element != "vertex":
        return 0
    if not re.fullmatch("[0-9]{1,15}", count):
        raise InputError(f"{path}: expected a number of vertices, got {count[:60]!r}.")
    return int(count)


def _column(path: Path, fields: list[str]) -> tuple[str, str]:
    """Name and numpy type of a vertex property."""
    if len(fields) != 2 or fields[0] not in _TYPES:
        raise InputError(
            f"{path}: a vertex property of an unknown type: {' '.join(fields)!r}."
        )
    kind, name = fields
    return name, _TYPES[kind]
