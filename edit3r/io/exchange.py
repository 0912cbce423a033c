"""Swap two paths in one step, where the operating system can."""

import ctypes
import os
import sys
from pathlib import Path

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2  # linux/fs.h
_RENAME_SWAP = 2  # macOS sys/stdio.h


def exchange(new: Path, old: Path) -> None:
    """Swap the names of two existing folders on one file system.

    One step on Linux and macOS. Elsewhere, or on a file system that cannot, two renames: between them, for an
    instant, nothing carries the name `old`, but both folders are whole.
    """
    if not _exchange_in_one_step(os.fsencode(new), os.fsencode(old)):
        aside = old.with_name(f"{new.name}-old")
        os.rename(old, aside)
        os.rename(new, old)
        os.rename(aside, new)


def _exchange_in_one_step(new: bytes, old: bytes) -> bool:
    if not sys.platform.startswith(("linux", "darwin")):
        return False
    library = ctypes.CDLL(None, use_errno=True)
    try:
        if sys.platform == "darwin":
            return library.renamex_np(new, old, _RENAME_SWAP) == 0
        return library.renameat2(_AT_FDCWD, new, _AT_FDCWD, old, _RENAME_EXCHANGE) == 0
    except AttributeError:  # a C library without the call
        return False
