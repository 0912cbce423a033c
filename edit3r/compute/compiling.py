"""Loops compiled by numba, whose machine code is kept on disk where that is possible."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, NullCache
from numba.core.runtime.nrt import rtsys

from edit3r.reporting import warn

__all__ = ["compiled"]


def compiled(**options: Any) -> Callable[[Callable], Callable]:
    """Compile the decorated function as `numba.njit(cache=True, **options)` does, but never fail
    because of the cache.

    Where no folder can be written to, a warning says so and every process compiles anew. Kept code
    that cannot be read, such as a file that was cut off by a full disk, is compiled again and
    replaced. For loops over arrays and numbers: kept code must need no more of numba than its
    memory, as dictionaries and sets of texts do.
    """

    def decorate(function: Callable) -> Callable:
        dispatcher = njit(**options)(function)
        try:
            dispatcher._cache = _ForgivingCache(
                function
            )  # what `cache=True` sets, without numba's class
        # numba found neither the function's own folder nor the user's cache folder writable
        except RuntimeError:
            dispatcher._cache = _NoCache()
        return dispatcher

    return decorate


class _ForgivingCache(FunctionCache):
    """numba's cache, in which a file that cannot be read or written is as good as none."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            # numba would first import all that it can compile, a third of a second: kept code needs
            # its memory alone.
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except Exception:  # a damaged pickle raises anything
            with suppress(OSError):
                self.flush()  # an index of nothing
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk, or a folder that became read-only
            super().save_overload(sig, data)


class _NoCache(NullCache):
    """Keeps nothing, and says so when something is compiled: while modules load, nobody would hear
    it.
    """

    def save_overload(self, sig: Any, data: Any) -> None:
        warn(
            "No folder to keep compiled kernels in: they are compiled anew in every process, "
            "which takes seconds. "
            "Name a writable folder in the environment variable NUMBA_CACHE_DIR."
        )
