"""Damaged JPEGs: libjpeg fills what it cannot read with grey, and only prints a remark."""

import os
import re
import sys
import tempfile
import threading
from contextlib import suppress
from typing import BinaryIO

import cv2
import numpy as np

_REMARK = re.compile(rb"Corrupt JPEG data: ([^\n]{1,200})\n?")
_STRAY = re.compile(rb"(\d+) extraneous bytes before marker")
FEW_STRAY = 32  # bytes between parts that some cameras leave; nothing is lost by them
_LISTENING = threading.Lock()


def damage_of(file: BinaryIO) -> str:
    """What libjpeg says of the inside of a JPEG; empty for a whole one."""
    remarks = _printed_about(np.frombuffer(file.read(), np.uint8))
    stray = _STRAY.match(remarks)
    if stray and int(stray[1]) <= FEW_STRAY:
        return ""
    return remarks.decode("ascii", "replace")


def _printed_about(coded: np.ndarray) -> bytes:
    """The remark that libjpeg prints of the coded image; nobody else hands it on.

    It goes to file 2 of the process, which is a temporary file meanwhile: what others print there
    in these milliseconds is printed after them.
    """
    with _LISTENING, tempfile.TemporaryFile() as heard:
        with suppress(OSError, ValueError, AttributeError):
            sys.stderr.flush()
        try:
            outside = os.dup(2)
        except OSError:  # a process without one
            return b""
        try:
            os.dup2(heard.fileno(), 2)
            cv2.imdecode(coded, cv2.IMREAD_REDUCED_COLOR_8)
        finally:
            os.dup2(outside, 2)
            os.close(outside)
        heard.seek(0)
        printed = heard.read()
        remark = _REMARK.search(printed)
        with suppress(OSError):
            os.write(2, _REMARK.sub(b"", printed))
    return remark[1] if remark else b""
