"""Names of files: made of any text, told from paths, put in order; and the home folder, which not
every user has: containers, services and job runners make users without one.
"""

import itertools
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TypeGuard

from edit3r.contract.errors import InputError

_MAX_CHARACTERS = 100  # of a name from `unique_names`
_MAX_BYTES = 200  # file systems allow 255 with the suffix

# Surrogates stand for the bytes of a file name that is no UTF-8.
# The others turn the direction of what follows: "gpj.exe" may be shown as "exe.jpg".
_UNSAFE = re.compile(
    r'[\x00-\x1f\x7f/\\:*?"<>|\ud800-\udfff\u202a-\u202e\u2066-\u2069]|\.\.+'
)
# Names that Windows reserves, and those of the video's frames.
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?|path_\d+", re.IGNORECASE)


# Path() makes one slash of two; a single letter is a drive.
_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]+):/{1,3}[^/]|(data):|(www)\.", re.IGNORECASE)
_ARCHIVE = re.compile(
    r"\.(zip|7z|rar|tgz|tar(\.\w{1,4})?|gz|bz2|xz|zst)$", re.IGNORECASE
)


def unique_names(names: Sequence[str]) -> list[str]:
    """File names without suffix from any texts: valid on every system, no two alike.

    A safe name that nobody else has is kept. Otherwise characters that a file system may refuse
    become "_", names that Windows or the frames of the video use get "_" in front, names above 100
    characters are cut, and equal names are numbered ("-1", "-2", ...). Names that differ only in
    case count as equal, as some file systems take them.
    """
    safe = [_safe_name(name) for name in names]
    counts = Counter(map(_same_file, safe))
    alone = {folded for folded, count in counts.items() if count == 1}
    taken = set(alone)
    # Where counting goes on: thousands of equal names are no reason to count from 1 again.
    numbers: Counter[str] = Counter()
    result = []
    for name in safe:
        if _same_file(name) not in alone:
            alike = _same_file(name)
            name, numbers[alike] = _numbered(name, taken, numbers[alike] + 1)
            taken.add(_same_file(name))
        result.append(name)
    return result


def refuse_elsewhere(path: str | Path) -> None:
    """Raise InputError, with what to do, for a web address and for an archive of files."""
    text = str(path)
    address = _ADDRESS.match(text)
    if address and not Path(text[:200]).exists():
        raise InputError(
            f"{text[:200]}: a web address; download what lies there, and give the files."
        )
    if _ARCHIVE.search(text) and Path(text).is_file():
        raise InputError(f"{path}: an archive; unpack it, and give what was in it.")


def require_there(path: str | Path) -> None:
    """Raise InputError for what is neither file nor folder, nor a pattern with * or ?, here."""
    refuse_elsewhere(path)
    if not any(sign in str(path) for sign in "*?[") and not Path(path).exists():
        raise InputError(f"{path}: no such file or folder.")


def is_plain_name(name: object) -> TypeGuard[str]:
    """Whether a name from a stranger's file names a file or folder, and is no path elsewhere."""
    return (
        isinstance(name, str)
        and 0 < len(name) <= 120
        and not _UNSAFE.search(name)
        and name.strip(". ") != ""
    )


def _safe_name(name: str) -> str:
    name = _UNSAFE.sub("_", name).strip(". ") or "photo"
    return _cut(f"_{name}" if _RESERVED.fullmatch(name) else name)


def _numbered(name: str, taken: set[str], first: int) -> tuple[str, int]:
    """The name with the first number, from `first` on, that nobody has; and that number."""
    for number in itertools.count(first):
        ending = f"-{number}"
        unique = _cut(name, len(ending)) + ending
        if _same_file(unique) not in taken:
            return unique, number
    raise AssertionError


def _cut(name: str, room: int = 0) -> str:
    """The name without what is too long for a file name that ends with `room` more characters."""
    name = name[: _MAX_CHARACTERS - room]
    while len(name.encode()) + room > _MAX_BYTES:
        name = name[:-1]
    return name.rstrip(". ")


def _same_file(name: str) -> str:
    """Equal for two names that a file system may take for one."""
    return unicodedata.normalize("NFC", name).casefold()


def natural(path: Path) -> tuple:
    """Sort key in which digits count as numbers; the plain name decides between equals."""
    key = []
    for part in re.split(r"(\d+)", path.name.casefold()):
        is_number = part.isdecimal()
        key.append((is_number, int(part) if is_number else part))
    return key, path.name


def expanded(path: str | Path) -> Path:
    """The path with the home folder for ~. Raises InputError where there is none."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise InputError(
            f"{path}: this user has no home folder for ~ to stand for; give the full path."
        ) from None


def user_cache() -> Path | None:
    """Where programs keep what they can make or fetch again; None for a user without a home.

    A folder that would depend on the current one, which may be a stranger's, is none.
    """
    for folder in (
        os.environ.get("XDG_CACHE_HOME") or "",
        os.path.expanduser("~/.cache"),
    ):
        if os.path.isabs(folder):
            return Path(folder)
    return None
