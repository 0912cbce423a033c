"""Python processes that edit3r starts: none imports from the current folder.

That folder may be a stranger's, with a `torch.py` in it that would run.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable that keeps the current folder off the path of Python 3.11 and newer."""

PYTHON = (sys.executable, "-P" if sys.version_info >= (3, 11) else "-I")
"""Start of a command for another Python process."""


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep the current folder off the path of processes that multiprocessing starts inside.

    Such a process calls `restore_path` for its own children: a script of the user may import what
    lies beside it.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        restore_path(before)


def restore_path(before: str | None) -> None:
    """Set the variable back to what it was outside of `safe_path`."""
    if before is None:
        os.environ.pop(SAFE_PATH, None)
    else:
        os.environ[SAFE_PATH] = before
