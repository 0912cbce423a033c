"""The user's home folder, which not every user has: containers, services and job runners make users
without one.
"""

import os
from pathlib import Path

from edit3r.contract.errors import InputError


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
