"""What commands share that leave results: progress on the terminal, folders, files, tables.

Nothing here imports torch, for a command line is parsed without it.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.text import parse_json

Item = TypeVar("Item")


@contextmanager
def shown_stages(quiet: bool) -> Iterator[Report]:
    """Show stages and progress inside the block on the terminal, unless `quiet`."""
    from edit3r.kit.command.console import StageConsole

    with (
        StageConsole(quiet=quiet) as console,
        collecting(Report(on_event=console)) as report,
    ):
        yield report


def markdown_table(rows: Sequence[Mapping[str, str]], left: int = 1) -> str:
    """Return rows of cells by title as a Markdown table without a last newline.

    Its first `left` columns are set left, the others right; a cell that a row lacks is a dash.
    """
    if not rows:
        return "None."
    titles = list(dict.fromkeys(title for row in rows for title in row))
    ruler = ["---"] * left + ["--:"] * (len(titles) - left)
    lines = [titles, ruler]
    lines += [[row.get(title, "-") for title in titles] for row in rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def grouped(items: Iterable[Item], key: Callable[[Item], str]) -> dict[str, list[Item]]:
    """Return the items by key, keys in the order in which they first occur."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def make_folder(folder: Path) -> Path:
    """Make a folder for results, and return it. Raises InputError where that cannot be done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be created ({error.strerror}); give --out another folder."
        ) from None
    return folder


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder of results, so that no row is written twice.

    Raises InputError where another process is at work there.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(make_folder(folder) / ".edit3r.lock")
    try:
        held = lock.acquire(blocking=False)
    except Timeout:
        raise InputError(
            f"{folder}: another run writes its results there; wait for it, or give --out "
            "another folder."
        ) from None
    with held:
        yield


def read_json(path: Path) -> Any:
    """Return the content of a JSON file. Raises InputError naming a file that is none."""
    try:
        return parse_json(path.read_bytes())
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}).") from None


def write_text(path: str | Path, content: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_write(path) as partial:
        partial.write_text(content, encoding="utf-8")


def write_json(path: str | Path, content: Any, indent: int = 1) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json.dumps(content, indent=indent, ensure_ascii=False) + "\n")
