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
    """Make the standard streams such that printing never ends the program.

    Services start programs with closed streams: those become the null device. Letters that a code
    page lacks are escaped. When whoever reads standard error goes away, what is written there is
    dropped. Standard output stays as it is: `edit3r list-plugins | head` may end.
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
    """Run `edit3r.cli.main.main` as all that a process does; returns the exit code.

    Ctrl-C ends it with one line and exit code 130, even while modules are imported, and where a
    library turns the interruption into an error of its own.
    """
    steady_streams()
    # Read when torch is imported. Else waiting threads of OpenMP spin and take the cores from those
    # that work: beside a browser a run took twice the seconds.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    interruptions: list[int] = []

    def interrupt(number: int, frame: object) -> None:
        interruptions.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    # Importing torch makes objects that stay. Looking for garbage among them, meanwhile and on
    # leaving, took 0.7 of the 2.7 seconds of a process that only imports it.
    gc.set_threshold(10_000)
    try:
        from edit3r.loading.entry_points import hide_unreadable

        hide_unreadable()
        from edit3r.cli.main import main

        return main(interruptions=interruptions)
    except KeyboardInterrupt:
        print("edit3r: interrupted.", file=sys.stderr)
        return 130
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt
        gc.freeze()
