"""Loops compiled by numba, whose machine code is kept on disk where that is possible."""

import importlib
import os
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from types import ModuleType
from typing import Any

import yaml

from edit3r.contract.reporting import warn

__all__ = ["compiled", "is_kept", "numba"]


def _import_numba() -> ModuleType:
    """Import numba without the settings in `.numba_config.yaml` of the current folder.

    The folder may be a stranger's, and the file may name a folder of pickles for numba to load.
    """
    # without it, numba only warns of such a file
    sys.modules["yaml"] = None  # type: ignore[assignment]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            numba = importlib.import_module("numba")
    finally:
        sys.modules["yaml"] = yaml
    numba.core.config._config_fname = os.devnull  # it looks again when it compiles
    # NUMBA_DISABLE_JIT is for debugging plain loops; ours hold intrinsics, which only compile.
    numba.core.config.DISABLE_JIT = 0
    return numba


numba = _import_numba()
"""Every module takes numba from here, so that none imports it in another way before."""


def compiled(**options: Any) -> Callable[[Callable], Callable]:
    """Compile the function as `numba.njit(cache=True, **options)`; the cache never fails it.

    Where no folder can be written to, a warning says so and every process compiles anew. Kept code
    that cannot be read, such as a file that was cut off by a full disk, is compiled again and
    replaced. For loops over arrays and numbers: kept code must need no more of numba than its
    memory, as dictionaries and sets of texts do.
    """

    def decorate(function: Callable) -> Callable:
        dispatcher = numba.njit(**options)(function)
        try:
            # what `cache=True` sets, without numba's class
            dispatcher._cache = _ForgivingCache(function)
        # neither the function's own folder nor the user's cache folder can be used
        except RuntimeError:
            dispatcher._cache = _NoCache()
        return dispatcher

    return decorate


def is_kept(function: Any) -> bool:
    """Whether the function's machine code lies in the cache, or no cache could take it."""
    cache = function._cache
    return isinstance(cache, _NoCache) or cache.holds_code()


class _ForgivingCache(numba.core.caching.FunctionCache):
    """numba's cache, in which a file that cannot be read or written is as good as none.

    Raises RuntimeError where there is no folder for it whose full path is known.
    """

    class _impl_class(numba.core.caching.CompileResultCacheImpl):
        @property
        def _locator_classes(self) -> list[type]:
            return [
                _whole(one) for one in numba.core.caching.CacheImpl._locator_classes
            ]

    def holds_code(self) -> bool:
        """Whether there is code of the function's present source."""
        try:
            return bool(self._cache_file._load_index())
        except Exception:  # a damaged pickle raises anything
            return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            # numba would first import all that it can compile, a third of a second: kept code needs
            # its memory alone.
            numba.core.runtime.nrt.rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except Exception:  # a damaged pickle raises anything
            with suppress(OSError):
                self.flush()  # an index of nothing
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk, or a folder that became read-only
            super().save_overload(sig, data)


def _whole(locator: type) -> type:
    """A way to find a folder for compiled code, which never finds one that depends on the current
    folder: its files are pickles, and the current folder may be a stranger's.
    """

    class Whole(locator):
        def ensure_cache_path(self) -> None:
            if not os.path.isabs(self.get_cache_path()):
                raise OSError("the folder for compiled code depends on the current one")
            super().ensure_cache_path()

    return Whole


class _NoCache(numba.core.caching.NullCache):
    """Keeps nothing, and says so when something is compiled: nobody hears it while modules load."""

    def save_overload(self, sig: Any, data: Any) -> None:
        warn(
            "No folder to keep compiled kernels in: they are compiled anew in every process, which "
            "takes seconds. Name a writable folder, by its full path, in the environment variable "
            "NUMBA_CACHE_DIR."
        )
