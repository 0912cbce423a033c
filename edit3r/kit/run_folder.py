"""The folder that a run leaves: where each result lies in it; and `run.json`, how it was made."""

import dataclasses
import importlib.metadata
import json
import math
import platform
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from edit3r.contract.reporting import StageRecord
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict, Verdict
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.photos.images import Photo
from edit3r.version import __version__

FORMAT = 1
"""Version of the layout of `run.json`; raised when a field changes its meaning or goes."""

FRAME = (
    "camera of view 0; OpenCV axes (x right, y down, z forward); c2w; "
    "the length unit is arbitrary"
)
"""Of a scene and its cameras, unless `RunManifest.frame` says another."""

_PACKAGES = (
    *("torch", "numpy", "pillow", "opencv-contrib-python-headless", "kornia"),
    *("scikit-image", "scipy", "pycolmap", "numba", "llvmlite"),
)
_SECRET = re.compile(
    r"(^|_)(api_?key|key|token|secret|password|passwd|credentials?|authorization)$",
    re.IGNORECASE,
)


class RunFolder:
    """Where each result lies inside a run's folder `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.scene = root / "scene.ply"  # the edited 3D Gaussians
        # photo, 2D edit and 3D result of each view on one sheet
        self.before_after = root / "before_after.png"
        self.video = root / "video.webm"  # the camera path
        self.viewer = root / "viewer.html"  # the scene in one page that opens from disk
        self.cameras = root / "cameras.json"  # intrinsics and poses of the input views
        self.manifest = root / "run.json"  # how the run was made

    def made(self, name: Literal["inputs", "edited", "renders", "masks"]) -> Path:
        """The folder of photos as they were used, 2D edits, images of the scene, or masks of what
        was named (a folder for each); made when asked for.
        """
        folder = self.root / name
        folder.mkdir(exist_ok=True)
        return folder


@dataclass(frozen=True)
class PluginRecord:
    """One component that took part."""

    kind: str
    name: str
    plugin: str
    version: str
    licence: str
    needs_network: bool = False


@dataclass(frozen=True)
class WeightsRecord:
    """One weight file that was loaded."""

    file: str
    sha256: str
    licence: str


@dataclass(frozen=True)
class RunManifest:
    """Everything `run.json` says, in its order."""

    prompt: str
    seed: int
    device: str
    settings: Mapping[str, Any]  # resolved, as JSON data
    plugins: Sequence[PluginRecord]
    inputs: Sequence[Photo]
    masks: Mapping[str, str]  # file: sha256
    weights: Sequence[WeightsRecord]
    verdict: Verdict
    edit_verdict: EditVerdict | None  # None: no edit
    selection_verdict: SelectionVerdict | None  # None: nothing was looked for
    gaussians: int
    harmonics_degree: int
    stages: Sequence[StageRecord]
    warnings: Sequence[str]
    notes: Mapping[str, Any]
    frame: str = FRAME
    versions: Mapping[str, str] = field(default_factory=lambda: installed_versions())
    format: int = FORMAT


def write_manifest(path: str | Path, manifest: RunManifest) -> None:
    """Write as JSON: the class's order, mappings sorted, secrets blanked, not finite as null."""
    content = {
        item.name: recorded(getattr(manifest, item.name))
        for item in dataclasses.fields(manifest)
    }
    with atomic_write(path) as partial:
        text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
        partial.write_text(text + "\n", encoding="utf-8")


def continue_run(
    before: Path, root: Path, folders: Sequence[str], content: Mapping[str, Any]
) -> None:
    """Write what stays true of the run in `before` into the folder `root`: cameras, the `folders`
    of images that are there, and run.json with this `content`.

    The run may be a stranger's: what is a link there is not followed, and a linked folder left out.
    """
    old, new = RunFolder(before), RunFolder(root)
    shutil.copyfile(old.cameras, new.cameras)
    for name in folders:
        source = before / name
        if source.is_dir() and not source.is_symlink():
            shutil.copytree(source, root / name, symlinks=True)
    text = json.dumps(content, indent=2, ensure_ascii=False)
    new.manifest.write_text(text + "\n", encoding="utf-8")


def installed_versions() -> dict[str, str]:
    """Versions of Python, edit3r and the packages that results depend on, and the platform."""
    versions = {
        "edit3r": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
    }
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    commit = _source_commit()
    if commit:
        versions["commit"] = commit
    return versions


def _source_commit() -> str:
    """The commit of the checkout that edit3r runs from; "" for an installed package."""
    git = Path(__file__).parents[2] / ".git"
    try:
        head = (git / "HEAD").read_text(encoding="ascii").strip()
        if not head.startswith("ref: "):
            return head
        return (git / head.removeprefix("ref: ")).read_text(encoding="ascii").strip()
    except (OSError, UnicodeError):  # packed away, or no checkout at all
        return ""


def recorded(value: Any, name: str = "") -> Any:
    """JSON data of nested dataclasses, mappings, sequences and settings; secrets are blanked."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return _recorded_scalar(value, name)
    if hasattr(value, "get_secret_value"):  # pydantic's SecretStr
        return "(not recorded)"
    if hasattr(value, "model_dump"):
        return recorded(value.model_dump())
    if dataclasses.is_dataclass(value):
        return {
            item.name: recorded(getattr(value, item.name), item.name)
            for item in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {
            str(key): recorded(value[key], str(key)) for key in sorted(value, key=str)
        }
    if isinstance(value, (list, tuple, set, frozenset)):
        items = sorted(value) if isinstance(value, (set, frozenset)) else value
        return [recorded(item) for item in items]
    if hasattr(value, "tolist"):  # numpy and torch
        return recorded(value.tolist())
    return str(value)


def _recorded_scalar(value: Any, name: str) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if not isinstance(value, str):
        return value
    if value and _SECRET.search(name):
        return "(not recorded)"
    # a file name may be no UTF-8
    return value.encode(errors="backslashreplace").decode()
