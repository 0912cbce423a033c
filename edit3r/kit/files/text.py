"""Text and JSON that may come from anybody, read within bounds."""

import errno
import json
import math
import re
from functools import partial
from pathlib import Path
from typing import Any

# Half of a pair of code units, which no file or terminal can hold; but from U+DC80 to U+DCFF stand
# the bytes of a file name that is no UTF-8 (PEP 383).
HALF = re.compile(r"[\ud800-\udc7f\udd00-\udfff]")


def parse_json(content: str | bytes, *, finite: bool = True) -> Any:
    """What a text of JSON holds. Raises ValueError with the reason for what is none, is nested too
    deeply, gives a key twice, or holds characters and, where they are to be `finite`, numbers that
    JSON has not (lone surrogates, NaN).
    """
    text = content if isinstance(content, str) else _decoded(content)
    try:
        tree = json.loads(
            text,
            parse_constant=_no_number if finite else None,
            parse_float=_number if finite else None,
            object_pairs_hook=partial(_object, text),
        )
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if "\\ud" in text or "\\uD" in text or HALF.search(text):
        _check_text(tree)
    return tree


def read_json(path: Path) -> Any:
    """What a file of JSON holds. Raises OSError for what is no file, else as `parse_json` does."""
    return parse_json(read_plain(path))


def _decoded(content: bytes) -> str:
    """Text in the encoding that its first bytes show: PowerShell writes UTF-16."""
    return content.decode(json.detect_encoding(content))


def _object(text: str, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The mapping of an object in a text of JSON."""
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        places = re.finditer(rf"{re.escape(json.dumps(twice))}\s*:", text)
        lines = [text.count("\n", 0, place.start()) + 1 for place in places]
        where = f" (line {lines[1]})" if len(lines) == 2 else ""
        raise ValueError(f"the key {twice[:60]!r} stands twice in one object{where}")
    return content


def _no_number(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _number(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text[:40]} is too large a number")
    return number


def _check_text(tree: Any) -> None:
    if HALF.search(json.dumps(tree, ensure_ascii=False)):
        raise ValueError("it holds half a character (a lone surrogate)")


def read_plain(path: Path) -> str:
    """The UTF-8 text of a file; raises OSError for what is none: reading a pipe that somebody gave
    the name of a file would never end.
    """
    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, "no such file", str(path))
    return path.read_text(encoding="utf-8")


def printable(text: str) -> str:
    """The text for a terminal: names in it may be no UTF-8, or hold commands for the terminal."""
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
