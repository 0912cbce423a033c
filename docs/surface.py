"""The names that plugins may use, one `module:name` a line.

    python docs/surface.py           # prints them
    python docs/surface.py --write   # writes docs/plugins/surface.txt

Read from the sources; nothing is imported.
"""

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/plugins/surface.txt"

WHOLE = "edit3r/contract"
"""The room of which every public name is promised."""

USED = "edit3r/kit"
"""The room of which those public names are promised that a plugin or an example uses."""

USERS = ("plugins", "examples")
TEMPLATES = "plugins/edit3r_develop/templates"

FRONTS = ("edit3r", "edit3r/loading", "edit3r/running")
"""Packages that promise what their `__init__.pyi` imports."""


def promised() -> list[str]:
    """All promised names, in order."""
    fronts = [ROOT / folder / "__init__.pyi" for folder in FRONTS]
    whole = _names_in([*fronts, *sorted((ROOT / WHOLE).rglob("*.py"))])
    kit = _names_in(sorted((ROOT / USED).rglob("*.py")))
    return sorted([*whole, *(name for name in kit if name in used())])


def _names_in(files: Iterable[Path]) -> list[str]:
    return [
        f"{_module(file)}:{name}"
        for file in files
        for name in public_names(ast.parse(file.read_text(encoding="utf-8")))
    ]


@cache
def used() -> set[str]:
    """Names that plugins and examples import, or take from a module that they import."""
    found: set[str] = set()
    for folder in USERS:
        for file in (ROOT / folder).rglob("*.py"):
            found.update(_used_in(ast.parse(file.read_text(encoding="utf-8"))))
    for template in (ROOT / TEMPLATES).rglob("*.py.txt"):
        text = template.read_text(encoding="utf-8")
        lines = re.findall(r"^from edit3r\.[\w.]+ import [\w, ]+$", text, re.M)
        found.update(_used_in(ast.parse("\n".join(lines))))
    return found


def _used_in(tree: ast.Module) -> Iterator[str]:
    modules = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.level:
            for alias in node.names:
                yield f"{node.module}:{alias.name}"
                modules[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            yield f"{modules.get(node.value.id)}:{node.attr}"


def public_names(tree: ast.Module) -> list[str]:
    """What a module's `__all__` lists; without one, what it defines without an underscore, or
    imports by another name as a stub does.
    """
    defined = [name for node in tree.body for name in _defined(node)]
    if "__all__" in defined:
        return _listed(tree)
    return [name for name in dict.fromkeys(defined) if not re.match("_[^_]", name)]


def _listed(tree: ast.Module) -> list[str]:
    return next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and list(_defined(node)) == ["__all__"]
    )


def _defined(node: ast.stmt) -> Iterator[str]:
    """Names that a statement at the top of a module defines; of imports those of stubs, which say
    the name again (`import run as run`).
    """
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        yield node.name
    if isinstance(node, ast.ImportFrom):
        yield from (alias.name for alias in node.names if alias.asname == alias.name)
    targets = node.targets if isinstance(node, ast.Assign) else []
    if isinstance(node, ast.AnnAssign):
        targets = [node.target]
    for target in targets:
        if isinstance(target, ast.Name):
            yield target.id


def _module(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def main() -> None:
    text = "\n".join(promised()) + "\n"
    if "--write" in sys.argv:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
