"""Text that a program writes between two marked lines of a page which is otherwise written by hand."""

import re
from pathlib import Path

from edit3r.errors import InputError
from edit3r.io.run_folder import atomic_write

__all__ = ["write_between"]


def write_between(page: Path, start: str, end: str, text: str) -> None:
    """Replace what stands between the lines `start` and `end` by `text`, whole lines; InputError where they are not."""
    before = page.read_text(encoding="utf-8")
    block = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
    if not block.search(before):
        raise InputError(f"{page}: has no lines {start!r} and {end!r} to write between.")
    with atomic_write(page) as partial:
        partial.write_text(block.sub(lambda _: f"{start}\n{text}{end}", before), encoding="utf-8")
