"""Scenes of other programs, read by gaussforge (extra `export`).

gaussforge works in a process of its own: a damaged file can end it, and it prints.
"""

import subprocess
import tempfile
from pathlib import Path

from edit3r.contract.errors import InputError, MissingDependencyError, RunError
from edit3r.contract.types import Gaussians
from edit3r.kit.children import PYTHON
from edit3r.kit.scenes.ply import load_ply

LONGEST = (
    600  # seconds of one conversion: SOG takes half a minute for 380,000 Gaussians
)
READ = (".spz", ".sog", ".splat", ".compressed.ply")
"""Ends of the files that gaussforge reads; without the first dot, its names of the formats."""
_CONVERT = """
import sys, gaussforge
data = open(sys.argv[1], "rb").read()
version = int(sys.argv[5])
answer = gaussforge.GaussForge().convert(data, *sys.argv[3:5], spz_version=version)
if "error" in answer:
    sys.exit(answer["error"])
open(sys.argv[2], "wb").write(answer["data"])
"""


def load_scene(path: str | Path) -> Gaussians:
    """Read a scene as PLY or one of `READ`, told by its suffix. Raises InputError for a file that
    is damaged.
    """
    path = Path(path)
    found = [end for end in READ if path.name.lower().endswith(end)]
    if path.suffix.lower() == ".glb":
        raise InputError(
            f"{path}: GLB is written but not read; export from the scene.ply of the run."
        )
    if not found:
        return load_ply(path, visible=True)
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    form = found[0][1:]
    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / "scene.ply"
        try:
            convert(path, plain, form, "ply")
            return load_ply(plain, visible=True)
        except (RunError, InputError) as error:
            raise InputError(
                f"{path}: cannot be read as {form}; {error}".replace(str(plain), "it")
            ) from None


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
