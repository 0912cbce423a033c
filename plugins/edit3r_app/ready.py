"""A process of `edit3r` that waits for its arguments: what takes seconds to import is there.

It is started beside the person's pointing, so that an edit begins at once. A server that ends, or
is killed, ends it too, whether it waits or works.
"""

import _thread
import contextlib
import json
import os
import runpy
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from edit3r.kit.children import PYTHON

WAITING = (*PYTHON, "-m", "edit3r_app.ready")
PATIENCE = 5.0  # [s] between asking a process to stop and ending it; no figure kept


def waiting(program: Sequence[str] = WAITING) -> subprocess.Popen:
    """Start such a process, in a session of its own."""
    return subprocess.Popen(
        program,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def begin(process: subprocess.Popen, arguments: Sequence[str], log: Path) -> None:
    """Let it carry out a command, which writes into `log`."""
    assert process.stdin is not None  # it is a pipe
    process.stdin.write(json.dumps([str(log), *arguments]).encode() + b"\n")
    process.stdin.flush()


def take() -> list[str]:
    """Wait for arguments, and write from then on into the file that comes with them; the process
    ends where the server does.
    """
    server, told = os.dup(0), b""
    while not told.endswith(b"\n"):
        read = os.read(server, 1 << 16)
        if not read:
            sys.exit()
        told += read
    log, *arguments = json.loads(told)
    with open(os.devnull, "rb") as nothing, open(log, "wb") as output:
        for stream, file in enumerate((nothing, output, output)):
            os.dup2(file.fileno(), stream)
    threading.Thread(target=_end_with, args=(server,), daemon=True).start()
    return arguments


def _end_with(server: int) -> None:
    """Interrupt the command when the server is gone; end it where it does not obey."""
    os.read(server, 1)
    _thread.interrupt_main()
    time.sleep(PATIENCE)
    send(getattr(signal, "SIGKILL", signal.SIGTERM), os.getpid())


def send(kind: signal.Signals, pid: int) -> None:
    """Send a signal to a process that leads a session, and to all that it started."""
    with contextlib.suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(pid, kind)
        else:
            os.kill(pid, kind)


def _prepare() -> None:
    """Import what most runs import, with the reconstructor that most of them use."""
    from edit3r import default_registry
    from edit3r.contract.errors import Edit3rError
    from edit3r.running import DEFAULTS, run  # noqa: F401

    for kind in ("reader", "editor", "reconstructor", "rasterizer", "segmenter"):
        with contextlib.suppress(Edit3rError):
            default_registry().build(kind, DEFAULTS[kind])


def main() -> None:
    with contextlib.suppress(Exception):  # the command says better what is wrong
        _prepare()
    sys.argv = ["edit3r", *take()]
    runpy.run_module("edit3r", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
