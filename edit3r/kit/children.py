"""Python processes that edit3r starts: none imports from the current folder.

That folder may be a stranger's, with a `torch.py` in it that would run.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable that keeps the current folder off the path of Python 3.11 and newer."""

PYTHON = (sys.executable, "-P" if sys.version_info >= (3, 11) else "-I")
"""Start of a command for another Python process."""


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables inside the block, for the processes that start there."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            _restore(name, value)


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep the current folder off the path of processes that multiprocessing starts inside.

    Such a process calls `restore_path` for its own children: a script of the user may import what
    lies beside it.
    """
    with environment({SAFE_PATH: "1"}):
        yield


def restore_path(before: str | None) -> None:
    """Set the variable back to what it was outside of `safe_path`."""
    _restore(SAFE_PATH, before)


def _restore(name: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(name, None)
    else:
        os.environ[name] = value
