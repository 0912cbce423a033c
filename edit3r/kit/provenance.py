"""How a result was made, as JSON data: versions of packages, and settings without secrets."""

import dataclasses
import importlib.metadata
import math
import platform
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edit3r.version import __version__

_PACKAGES = (
    *("torch", "numpy", "pillow", "opencv-contrib-python-headless", "kornia"),
    *("scikit-image", "scipy", "pycolmap", "numba", "llvmlite"),
)
_SECRET = re.compile(
    r"(^|_)(api_?key|key|token|secret|password|passwd|credentials?|authorization)$",
    re.IGNORECASE,
)


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
