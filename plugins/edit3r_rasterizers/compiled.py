"""The two ways functions are compiled here."""

import hashlib
from collections.abc import Callable
from pathlib import Path

from numba import njit

from edit3r.reporting import warn


def _digest_of_sources() -> str:
    """Changes whenever a file of this folder does."""
    content = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    return hashlib.sha256(content).hexdigest()[:12]


_SOURCES = _digest_of_sources()


def kernel(function: Callable) -> Callable:
    """A loop called from Python: kept on disk once compiled, and run without the GIL, so that threads overlap.

    numba names its files after the function and looks at that function's own file for changes; with the digest in the
    name, a change of what the kernel inlines from elsewhere compiles it anew instead of running what was.
    """
    function.__qualname__ = f"{function.__qualname__}_{_SOURCES}"
    options = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # numba found neither this folder nor the user's cache folder writable
        warn(
            "No folder to keep compiled kernels in: they are compiled anew in every process, which takes seconds. "
            "Name a writable folder in the environment variable NUMBA_CACHE_DIR."
        )
        return njit(**options)(function)


inlined = njit(error_model="numpy", forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""A part of a kernel, not to be called from Python. Passing arrays to a real function would cost more than many of
these parts do."""
