"""Text of a file that may be a stranger's."""

import errno
from pathlib import Path


def read_plain(path: Path) -> str:
    """The UTF-8 text of a file; raises OSError for what is none: reading a pipe that somebody gave
    the name of a file would never end.
    """
    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, "no such file", str(path))
    return path.read_text(encoding="utf-8")
