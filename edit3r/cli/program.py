"""A process that runs one command."""

import contextlib
import gc
import io
import os
import signal
import sys


class SteadyText(io.TextIOWrapper):
    """A stream whose reader may go away: a run that nobody watches goes on."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError:
            return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            super().flush()


def steady_streams() -> None:
    """Standard streams that no output ends the program through.

    A stream may be closed, as services start programs, its code page may lack letters of a file's
    name, and the reader of standard error may go away. Standard output still ends what is only
    there to be read, such as a list.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            stream = open(os.devnull, mode, encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, stream)
        if mode == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # The old one is kept by `sys.__stderr__`: thrown away, it would close what lies below it.
    if sys.stderr is sys.__stderr__ and isinstance(sys.stderr, io.TextIOWrapper):
        sys.stderr = SteadyText(
            sys.stderr.buffer,
            encoding=sys.stderr.encoding,
            errors=sys.stderr.errors,
            line_buffering=True,
        )


def program() -> int:
    """`edit3r.cli.main.main` as all that a process does; returns the exit code.

    Ctrl-C ends it with one line and exit code 130, even while modules are imported, and where a
    library turns the interruption into an error of its own.

    Python looks for cycles among what importing torch leaves dozens of times, though all of it
    stays, and once more on leaving: 0.7 of the 2.7 seconds of a process that only imports it.

    Threads of OpenMP turn circles while they wait, and take the core from the one that they wait
    for wherever something else works too: a run beside a browser took twice the seconds.
    """
    steady_streams()
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # read when torch is imported
    interruptions: list[int] = []

    def interrupt(number: int, frame: object) -> None:
        interruptions.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    gc.set_threshold(10_000)
    try:
        from edit3r.cli.main import main

        return main(interruptions=interruptions)
    except KeyboardInterrupt:
        print("edit3r: interrupted.", file=sys.stderr)
        return 130
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt
        gc.freeze()
