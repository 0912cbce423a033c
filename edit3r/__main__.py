"""The program: `edit3r`, which is also `python -m edit3r`."""

import os
import sys


def _drop_current_folder() -> None:
    """Import nothing from the current folder, which Python puts first on the path.

    It may be a stranger's, with a `torch.py` in it.
    """
    safe = sys.flags.isolated or getattr(sys.flags, "safe_path", False)
    first = sys.path[0]
    if not safe and (first == "" or first == os.getcwd()):
        del sys.path[0]


if __name__ == "__main__":  # not in the workers that multiprocessing starts from it
    _drop_current_folder()

import gc  # noqa: E402  (after the path is safe)
import signal  # noqa: E402


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


if __name__ == "__main__":
    sys.exit(program())
