"""Tuned numbers say where they are from: who chose them on what, or that no figure is kept."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("edit3r", "plugins")

SHARE = 0.85
"""Of the constants with tuned decimals, that must name a source."""

SOURCE = re.compile(
    r"docs/|by eye|no figures? kept|measured on|chosen|fitted|published|released code|formula"
    r"|package's code|the format|sanity|\(\w[^()]* \d{4}\)|et al\.",
    re.IGNORECASE,
)
"""A page, photos, a paper, a format or a formula; or the admission that nobody kept a figure."""


DECIMAL = re.compile(r"\d+\.\d{1,3}")


def is_tuned(node: ast.AST, text: str) -> bool:
    """Whether it is written with one to three decimals, and is not 0, a half or 1."""
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, float)
        and node.value not in (0.0, 0.5, 1.0)
        and DECIMAL.fullmatch(ast.get_source_segment(text, node) or "") is not None
    )


def constants(text: str) -> Iterator[tuple[str, str]]:
    """The module-level constants with tuned decimals, and all that is said of each: the comments
    in its lines and above it, those that head its block, and the docstring below it.
    """
    lines, body = text.splitlines(), ast.parse(text).body
    heading = ""
    for node, after in zip(body, [*body[1:], None]):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        first = node.lineno - 1
        while first and lines[first - 1].startswith("#"):
            first -= 1
        above = "\n".join(lines[first : node.lineno - 1])
        if not first or not lines[first - 1].strip():  # a block begins
            heading = above
        if not any(is_tuned(part, text) for part in ast.walk(node.value)):
            continue
        last = node.end_lineno
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            last = after.end_lineno
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        about = [heading, above, *lines[node.lineno - 1 : last]]
        yield ast.unparse(target), " ".join(about)


def all_constants() -> Iterator[tuple[str, str]]:
    for folder in FOLDERS:
        for file in sorted((ROOT / folder).rglob("*.py")):
            for name, about in constants(file.read_text(encoding="utf-8")):
                yield f"{file.relative_to(ROOT)}: {name}", about


def test_most_tuned_numbers_say_where_they_are_from():
    known = {name: bool(SOURCE.search(about)) for name, about in all_constants()}
    silent = [name for name, named in known.items() if not named]
    assert len(silent) <= (1 - SHARE) * len(known), "\n".join(silent)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("NEAR = 0.1  # of a depth", [False]),
        ("NEAR = 0.1  # of a depth; no figure kept", [True]),
        ("# chosen on four pairs\nNEAR = 0.1", [True]),
        ("# chosen on four pairs\n\nNEAR = 0.1", [False]),
        ('NEAR: float = 0.1\n"""Of a depth (Lowe 2004)."""', [True]),
        ("PAIR = (0.1, 3)\nOTHER = f(0.2)  # docs/notes/ledger.md", [False, True]),
        ("# By eye.\nNEAR = 0.1\nFAR = 0.2\n\nWIDE = 0.3", [True, True, False]),
        ("HALF, ALL, COUNT, EXACT, TINY = 0.5, 1.0, 7, 0.2126, 1e-3", []),
        ("def f():\n    return 0.1", []),
    ],
)
def test_a_source_is_read_from_the_words_about_its_own_constant(text, named):
    assert [bool(SOURCE.search(about)) for _, about in constants(text)] == named
