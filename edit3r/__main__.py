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

from edit3r.cli.program import program  # noqa: E402  (after the path is safe)

if __name__ == "__main__":
    sys.exit(program())
