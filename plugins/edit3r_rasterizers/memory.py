"""Work memory of the kernels."""

from collections.abc import Callable

import numpy as np


def scratch(count: int, dtype: type) -> Callable[[], np.ndarray]:
    """Work space that `run_slices` makes anew for every slice."""
    return lambda: aligned_empty((count,), dtype)


def aligned_empty(shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
    """Uninitialised memory that starts on a cache line, so that no vector straddles two."""
    count, size = int(np.prod(shape)), np.dtype(dtype).itemsize
    memory = np.empty(count + 64 // size, dtype)
    start = (-memory.ctypes.data % 64) // size
    return memory[start : start + count].reshape(shape)
