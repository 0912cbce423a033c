"""SOG that lies in loose files: a `meta.json` and the images that it names."""

import zipfile
from pathlib import Path
from typing import Any

from edit3r.contract.errors import InputError
from edit3r.kit.files.names import is_plain_name
from edit3r.kit.files.text import read_json

LOOSE = "meta.json"
MOST_FILES = 40  # that one names; it has about seven


def is_loose_sog(path: Path) -> bool:
    """Whether the file lists the images of a SOG."""
    return path.name == LOOSE and bool(_files_of(path))


def gathered(path: Path, archive: Path) -> Path:
    """Put a `meta.json` and the images that it names into one archive, as SOG is too."""
    names = _files_of(path)
    for name in names:
        if not is_plain_name(name):
            raise InputError(
                f"{path}: names {name[:60]!r}, which is no file beside it."
            )
        if not path.with_name(name).is_file():
            raise InputError(f"{path}: names {name}, which does not lie beside it.")
    with zipfile.ZipFile(archive, "w") as whole:
        for name in (LOOSE, *names):
            whole.write(path.with_name(name), name)
    return archive


def _files_of(path: Path) -> list[str]:
    """The images that a `meta.json` names; none where it is no SOG."""
    try:
        content = read_json(path)
    except (OSError, ValueError, RecursionError):
        return []
    if not isinstance(content, dict) or "means" not in content:
        return []
    columns: list[Any] = [one for one in content.values() if isinstance(one, dict)]
    listed = (one.get("files") for one in columns)
    named = [name for files in listed if isinstance(files, list) for name in files]
    texts = [name for name in dict.fromkeys(map(str, named))]
    return texts[:MOST_FILES]
