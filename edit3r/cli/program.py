"""A process that runs one command."""

import gc
import signal
import sys


def program() -> int:
    """`edit3r.cli.main.main` as all that a process does; returns the exit code.

    Ctrl-C ends it with one line and exit code 130, even while modules are imported, and where a
    library turns the interruption into an error of its own.

    Python looks for cycles among what importing torch leaves dozens of times, though all of it
    stays, and once more on leaving: 0.7 of the 2.7 seconds of a process that only imports it.
    """
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
