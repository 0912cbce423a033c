"""Hand memory back to the system while weights load: pages of the mapped file, and what the heap has freed."""

import ctypes
import mmap
import sys

from torch import Tensor

_PAGEOUT = 21
"""MADV_PAGEOUT (Linux 5.4): drops clean file pages from the process, never data; Python's mmap does not name it."""


def release_pages(tensor: Tensor) -> None:
    """Let go of the whole pages under `tensor`; only memory use changes, and only on Linux.

    Without this the mapped file counts as resident until all of it is read, beside the copy in use. The advice keeps
    the data valid whatever backs it, so it is safe for any tensor; where it is refused nothing happens.
    """
    if not sys.platform.startswith("linux"):
        return
    page = mmap.PAGESIZE
    start = -(-tensor.data_ptr() // page) * page
    length = (tensor.data_ptr() + tensor.nbytes) // page * page - start
    if length > 0:
        ctypes.CDLL(None).madvise(ctypes.c_void_p(start), ctypes.c_size_t(length), _PAGEOUT)


def release_heap() -> None:
    """Return freed heap memory to the system (glibc keeps it otherwise); nothing happens elsewhere."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform.startswith("linux") else None
    if trim is not None:
        trim(0)
