"""A process of `edit3r` that waits for its arguments: what takes seconds to import is there.

It is started beside the person's pointing, so that an edit begins at once. A server that ends, or
is killed, ends it too.
"""

import contextlib
import json
import os
import runpy
import socket
import subprocess
import sys
from collections.abc import Sequence
from typing import IO

from edit3r.kit.children import PYTHON

CAN_WAIT = hasattr(socket, "send_fds")  # not on Windows: files are sent by a socket
WAITING = (*PYTHON, "-m", "edit3r_app.ready")
PORTION = 1 << 16  # [bytes]


class ReadyProcess:
    """One such process, seen from the server."""

    def __init__(self, program: Sequence[str] = WAITING) -> None:
        self._asks, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [*program, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )

    def begin(self, arguments: Sequence[str], output: IO) -> subprocess.Popen | None:
        """Let it carry out a command, which writes into `output` and holds its lock.

        None where it ended meanwhile.
        """
        with self._asks, contextlib.suppress(OSError):
            if self.process.poll() is None:
                told = json.dumps(arguments).encode()
                sent = socket.send_fds(self._asks, [told[:PORTION]], [output.fileno()])
                self._asks.sendall(told[sent:])
                return self.process
        return None

    def end(self) -> None:
        self._asks.close()
        self.process.kill()
        self.process.wait()


def take(number: int) -> list[str] | None:
    """Wait for arguments at a socket, and write into the file that comes with them.

    None where the server ended.
    """
    with socket.socket(fileno=number) as asks:
        told, files, _, _ = socket.recv_fds(asks, PORTION, 1)
        told += b"".join(iter(lambda: asks.recv(PORTION), b""))
    if not files:
        return None
    for stream in (1, 2):
        os.dup2(files[0], stream)
    os.close(files[0])
    return json.loads(told)


def _prepare() -> None:
    """Import what most runs import, with the reconstructor that most of them use."""
    from edit3r import default_registry
    from edit3r.contract.errors import Edit3rError
    from edit3r.running import DEFAULTS, run  # noqa: F401

    for kind in ("reader", "editor", "reconstructor", "rasterizer", "segmenter"):
        with contextlib.suppress(Edit3rError):
            default_registry().build(kind, DEFAULTS[kind])


def main() -> None:
    _prepare()
    arguments = take(int(sys.argv[1]))
    if arguments is not None:
        sys.argv = ["edit3r", *arguments]
        runpy.run_module("edit3r", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
