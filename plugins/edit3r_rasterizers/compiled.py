"""The two ways functions are compiled here."""

from numba import njit

kernel = njit(cache=True, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
"""A loop called from Python: kept on disk once compiled, and run without the GIL, so that threads overlap."""

inlined = njit(error_model="numpy", forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""A part of a kernel; passing arrays to a real function would cost more than many of these parts do."""
