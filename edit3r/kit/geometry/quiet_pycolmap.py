"""pycolmap, imported so that a process ends and speaks as it did without it."""

import ctypes
import os
import signal

# Importing pycolmap makes the process print a stack trace when somebody ends it; what was to happen
# before happens again. By the C library, since Python sets handlers in its main thread only, and
# the app imports in another one.
_SET = getattr(ctypes.CDLL(None), "signal", None) if os.name == "posix" else None
if _SET is not None:
    _SET.restype, _SET.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
    _AT_TERM = _SET(signal.SIGTERM, None)
import pycolmap  # noqa: E402

if _SET is not None:
    _SET(signal.SIGTERM, _AT_TERM)
# Ceres warns on the terminal of each step that it takes back; the run judges the outcome itself.
pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)

__all__ = ["pycolmap"]
