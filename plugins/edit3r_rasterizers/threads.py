"""Run a kernel over slices of a range on several threads.

Kernels release the GIL, so plain Python threads do: no threading layer that a fork or a second caller could break.
Every number a kernel writes belongs to one element of the range, so results do not depend on the slices.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numba
import torch

_pools: dict[int, ThreadPoolExecutor] = {}

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)  # threads do not survive a fork


def thread_count(wanted: int) -> int:
    """`wanted`, or for 0 what the process was told: the smaller of torch's and numba's number of threads."""
    return wanted or max(1, min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS))


def run_slices(kernel: Callable, bounds: Sequence[int], threads: int, *arguments) -> list:
    """`kernel(bounds[k], bounds[k + 1], *arguments)` for every k, in any order; the results in order.

    A callable argument is called once per slice for the value to pass (scratch memory).
    """

    def call(first: int, last: int):
        return kernel(first, last, *(a() if callable(a) else a for a in arguments))

    slices = [(a, b) for a, b in pairwise(bounds) if a < b]
    if threads == 1 or len(slices) == 1:
        return [call(a, b) for a, b in slices]
    pool = _pools.get(threads)
    if pool is None:
        pool = _pools[threads] = ThreadPoolExecutor(threads, thread_name_prefix="edit3r-raster")
    return list(pool.map(lambda ab: call(*ab), slices))


def even_bounds(count: int, threads: int, least: int = 4096) -> list[int]:
    """Cut [0, count) into a few slices per thread, none shorter than `least` unless it is the only one."""
    slices = max(1, min(4 * threads if threads > 1 else 1, count // least))
    return [count * k // slices for k in range(slices + 1)]
