"""What the three commands share: checks of options, Markdown tables, groups of rows, and whole
files.

Nothing here imports torch, for a command line is parsed without it.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from edit3r.errors import InputError, SettingsError
from edit3r.io.atomic import atomic_write

Item = TypeVar("Item")


def check_least(args: argparse.Namespace, **least: int) -> None:
    """Raise SettingsError unless each option that is given is at least so large."""
    for option, smallest in least.items():
        value = getattr(args, option)
        if value is not None and value < smallest:
            raise SettingsError(
                f"--{option.replace('_', '-')}: must be at least {smallest}, got {value}."
            )


def markdown_table(
    titles: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1
) -> str:
    """Return a Markdown table whose first `left` columns are set left and the others right, without
    a last newline.
    """
    ruler = ["---"] * left + ["--:"] * (len(titles) - left)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (titles, ruler, *rows))


def format_or_dash(value: float | None, form: str) -> str:
    """Return a number as `form` says, "-" for None."""
    return "-" if value is None else format(value, form)


def grouped(items: Iterable[Item], key: Callable[[Item], str]) -> dict[str, list[Item]]:
    """Return the items by key, keys in the order in which they first occur."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def make_folder(folder: Path) -> Path:
    """Make the folder where results go, and return it. Raises InputError where that cannot be
    done.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be created ({error.strerror}); give --out another folder."
        ) from None
    return folder


def read_json(path: Path) -> Any:
    """Return the content of a JSON file. Raises InputError naming a file that is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}).") from None


def write_text(path: str | Path, content: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_write(path) as partial:
        partial.write_text(content, encoding="utf-8")


def write_json(path: str | Path, content: Any, indent: int = 1) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json.dumps(content, indent=indent, ensure_ascii=False) + "\n")
