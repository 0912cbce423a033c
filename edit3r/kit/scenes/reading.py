"""Scenes of any program, told by their content: PLY and GLB by own code, others by gaussforge
(extra `export`).

gaussforge works in a process of its own: a damaged file can end it, and it prints.
"""

import subprocess
import tempfile
import zlib
from pathlib import Path

import numpy as np

from edit3r.contract.errors import InputError, MissingDependencyError, RunError
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import Gaussians
from edit3r.kit.children import PYTHON
from edit3r.kit.files.names import refuse_elsewhere
from edit3r.kit.scenes.axes import UP_AND_BACK, flipped, sound
from edit3r.kit.scenes.files import gathered, is_loose_sog
from edit3r.kit.scenes.glb_reading import load_glb
from edit3r.kit.scenes.placement import placed_back, placement_of
from edit3r.kit.scenes.ply import load_ply
from edit3r.kit.scenes.spz_header import GZIP, read_spz_header

# seconds of one conversion: SOG takes half a minute for 380,000 Gaussians
LONGEST = 600
SPLAT_BYTES = 32  # of one Gaussian in a .splat, which has no header
MANY = 1_000_000  # Gaussians; fewer are no danger, whatever a file promises
_MAGIC = {b"ply": "ply", b"NGSP": "spz", b"glTF": "glb", b"PK": "sog"}
_CONVERT = """
import sys, gaussforge
data = open(sys.argv[1], "rb").read()
version = int(sys.argv[5])
answer = gaussforge.GaussForge().convert(data, *sys.argv[3:5], spz_version=version)
if "error" in answer:
    sys.exit(answer["error"])
open(sys.argv[2], "wb").write(answer["data"])
"""


@in_usual_torch
def load_scene(path: str | Path, *, visible: bool = True) -> Gaussians:
    """Read a scene of any format that `edit3r export` writes, told by its content.

    Where positions were brought into a unit that a format can hold, they come back in the scene's
    own. Raises InputError for a file that is damaged, and with `visible` for a scene in which
    nothing can be drawn.
    """
    path = Path(path)
    form = form_of(path)
    if form == "ply":
        return load_ply(path, visible=visible)
    if form == "glb":
        gaussians = load_glb(path, _spz_inside)
    else:
        gaussians = _converted(path, form)
    return sound(path, gaussians, visible=visible)


def _converted(path: Path, form: str) -> Gaussians:
    """A scene by gaussforge, which leaves positions and axes as they stand in the file."""
    header = read_spz_header(path) if form == "spz" else None
    with tempfile.TemporaryDirectory() as scratch:
        plain, source = Path(scratch, "scene.ply"), path
        if is_loose_sog(path):
            source = gathered(path, Path(scratch, "scene.sog"))
        try:
            convert(source, plain, form, "ply")
            gaussians = load_ply(plain)
        except (RunError, InputError) as error:
            raise InputError(
                f"{path}: cannot be read as {form}, it is damaged or cut off; "
                f"{str(error).replace(str(plain), 'it')}"
            ) from None
        placement = placement_of(source, form)
    if header is not None:
        gaussians = header.upright(gaussians)
    return placed_back(gaussians, placement)


def _spz_inside(content: bytes) -> Gaussians:
    """An SPZ from inside a GLB, which has the axes of the GLB and not those that SPZ says."""
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch, "inside.spz")
        file.write_bytes(content)
        try:
            if form_of(file) != "spz":
                raise ValueError("what it calls an SPZ is not one")
            return flipped(_converted(file, "spz"), UP_AND_BACK)
        except InputError as error:
            raise ValueError(str(error).replace(str(file), "its SPZ")) from None


def form_of(path: Path) -> str:
    """The format of a scene's file: ply, glb, or gaussforge's name of one. Raises InputError."""
    refuse_elsewhere(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    try:
        with path.open("rb") as file:
            start = file.read(1 << 16)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from None
    if start.startswith(GZIP):
        start = _unpacked(start)
        if not start.startswith(b"NGSP"):
            raise InputError(
                f"{path}: compressed with gzip, but not an SPZ (or a damaged one); decompress it "
                "first."
            )
    form = next((form for magic, form in _MAGIC.items() if start.startswith(magic)), "")
    if form == "ply" and b" packed_position" in start.partition(b"end_header")[0]:
        return "compressed.ply"
    if form == "spz":
        _check_count(path, int.from_bytes(start[8:12], "little"))
    if not form and is_loose_sog(path):
        return "sog"
    return form or _form_without_magic(path, start)


def _form_without_magic(path: Path, start: bytes) -> str:
    ending = path.suffix.lower()
    if ending in (".splat", ".ksplat") or _is_splat(path, start):
        return ending[1:] if ending == ".ksplat" else "splat"
    raise InputError(f"{path}: by its content not a PLY, SPZ, SOG, splat or GLB file.")


def _unpacked(start: bytes) -> bytes:
    """The first bytes of what a gzip stream that begins so holds."""
    try:
        return zlib.decompressobj(wbits=31).decompress(start, 64)
    except zlib.error:
        return b""


def _check_count(path: Path, count: int) -> None:
    """A Gaussian takes some bytes however well it is packed; less is made to fill the memory."""
    size = path.stat().st_size
    if count > MANY and size < count:
        raise InputError(
            f"{path}: promises {count:,} Gaussians in {size:,} bytes; it is damaged."
        )


def _is_splat(path: Path, start: bytes) -> bool:
    """Whether these are Gaussians of 32 bytes: finite centres and sizes, unit quaternions."""
    if not start or path.stat().st_size % SPLAT_BYTES:
        return False
    rows = np.frombuffer(start[: len(start) // SPLAT_BYTES * SPLAT_BYTES], np.uint8)
    rows = rows.reshape(-1, SPLAT_BYTES)
    numbers = rows[:, :24].copy().view("<f4")
    quaternions = (rows[:, 28:].astype(float) - 128) / 128
    norms = np.linalg.norm(quaternions, axis=1)
    return bool(
        np.isfinite(numbers).all()
        and (numbers[:, 3:] >= 0).all()
        and (abs(norms - 1) < 0.1).all()
    )


def convert(source: Path, target: Path, *forms: str, spz_version: int = 3) -> None:
    """Let gaussforge turn a file of one format into another.

    Raises MissingDependencyError where it is not installed, RunError where it fails.
    """
    command = [
        *PYTHON,
        "-c",
        _CONVERT,
        str(source),
        str(target),
        *forms,
        str(spz_version),
    ]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=LONGEST
        )
    except subprocess.TimeoutExpired:
        raise RunError(f"gaussforge gave no answer within {LONGEST} seconds.") from None
    reason = done.stderr.strip().splitlines()[-1:] or [
        f"it ended with code {done.returncode}"
    ]
    if "gaussforge" in reason[0] and "ModuleNotFoundError" in reason[0]:
        raise MissingDependencyError(
            f"{' to '.join(forms)} needs gaussforge; pip install 'edit3r[export]'."
        )
    if done.returncode or not target.is_file():
        raise RunError(f"gaussforge: {reason[0][:200]}.")
