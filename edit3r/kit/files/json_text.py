"""JSON that may come from anybody, read within bounds."""

import json
import re
from pathlib import Path
from typing import Any

from edit3r.kit.files.text import read_plain

# Half of a pair of code units, which no file or terminal can hold.
_HALF = re.compile(r"[\ud800-\udfff]")


def parse_json(content: str | bytes) -> Any:
    """What a text of JSON holds. Raises ValueError with the reason for what is none, is nested too
    deeply, or holds numbers and characters that JSON has not (NaN, lone surrogates).
    """
    text = content if isinstance(content, str) else _decoded(content)
    try:
        tree = json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if "\\ud" in text or "\\uD" in text or _HALF.search(text):
        _check_text(tree)
    return tree


def read_json(path: Path) -> Any:
    """What a file of JSON holds. Raises OSError for what is no file, else as `parse_json` does."""
    return parse_json(read_plain(path))


def _decoded(content: bytes) -> str:
    """Text in the encoding that its first bytes show: PowerShell writes UTF-16."""
    return content.decode(json.detect_encoding(content))


def _no_number(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _check_text(tree: Any) -> None:
    if _HALF.search(json.dumps(tree, ensure_ascii=False)):
        raise ValueError("it holds half a character (a lone surrogate)")
