"""How kernels are compiled, how they run on several threads, and their work memory.

Kernels release the GIL, so plain Python threads do: no threading layer that a fork or a second
caller could break. Every number a kernel writes belongs to one element of the range, so results do
not depend on the slices.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from edit3r.kit.compute.compiling import compiled, numba

LEAST_SLICE = 4096
_pools: dict[int, ThreadPoolExecutor] = {}

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)  # threads do not survive a fork


def _digest_of_sources() -> str:
    """Return a hash that changes whenever a file of this folder does."""
    content = b"".join(
        path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))
    )
    return hashlib.sha256(content).hexdigest()[:12]


_SOURCES = _digest_of_sources()


def kernel(function: Callable) -> Callable:
    """Compile a loop that is called from Python; it is kept on disk, and runs without the GIL, so
    that threads overlap.

    numba names its files after the function and looks at that function's own file for changes; with
    the digest in the name, a change of what the kernel inlines from elsewhere compiles it anew
    instead of running what was.
    """
    function.__qualname__ = f"{function.__qualname__}_{_SOURCES}"
    return compiled(error_model="numpy", nogil=True, no_cfunc_wrapper=True)(function)


inlined = numba.njit(
    error_model="numpy",
    forceinline=True,
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""A part of a kernel, not to be called from Python. Passing arrays to a real function would cost
more than many of these parts do.
"""


def thread_count(wanted: int) -> int:
    """Return `wanted`, or for 0 the smaller of torch's and numba's number of threads."""
    return wanted or max(
        1, min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS)
    )


def run_slices(
    kernel: Callable, bounds: Sequence[int], threads: int, *arguments
) -> list:
    """Call `kernel(bounds[k], bounds[k + 1], *arguments)` for every k, in any order; returns the
    results in order.

    A callable argument is called once per slice for the value to pass (scratch memory).
    """

    def call(first: int, last: int):
        return kernel(first, last, *(a() if callable(a) else a for a in arguments))

    slices = [(a, b) for a, b in pairwise(bounds) if a < b]
    if threads == 1 or len(slices) == 1:
        return [call(a, b) for a, b in slices]
    pool = _pools.get(threads)
    if pool is None:
        pool = _pools[threads] = ThreadPoolExecutor(
            threads, thread_name_prefix="edit3r-raster"
        )
    return list(pool.map(lambda ab: call(*ab), slices))


def even_bounds(count: int, threads: int) -> list[int]:
    """[0, count) in a few slices a thread, none but an only one shorter than LEAST_SLICE."""
    slices = max(1, min(4 * threads if threads > 1 else 1, count // LEAST_SLICE))
    return [count * k // slices for k in range(slices + 1)]


def scratch(count: int, dtype: type) -> Callable[[], np.ndarray]:
    """Return a function that allocates work memory, which `run_slices` calls once per slice."""
    return lambda: aligned_empty((count,), dtype)


def aligned_empty(shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
    """Uninitialised memory that starts on a cache line, so that no vector straddles two."""
    count, size = int(np.prod(shape)), np.dtype(dtype).itemsize
    memory: np.ndarray = np.empty(count + 64 // size, dtype)
    start = (-memory.ctypes.data % 64) // size
    return memory[start : start + count].reshape(shape)
