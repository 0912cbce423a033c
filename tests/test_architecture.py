"""The rules of the house: what may import what, how long things may get, and what the core may not
know.

Read from the sources alone (ast); nothing is imported but the registry, for the names of the
components.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import pytest

from edit3r.loading.registry import default_registry

ROOT = Path(__file__).parents[1]
CORE = "edit3r"

MAX_TOKENS = {"edit3r": 104_500, "edit3r_testing": 13_200, "plugins": 244_100}
MAX_IMPORTS_BETWEEN_PLUGINS = 12
MAX_PARAMETERS = 8
MAX_FILES_OF_A_RUN = 139  # 17 of them plugins that say what they offer

MANY_PARAMETERS = {
    "edit3r.api.run",  # the settings of a run stand in its signature
    "edit3r_rasterizers.functional.rasterization",  # those of gsplat's function
}
"""Functions that may have more parameters, as 'module.function', each with its reason."""

COMPILED_BY = {"njit", "compiled", "kernel", "inlined"}
"""Decorators of functions that numba compiles: a kernel is one loop, and takes its arrays one by
one.
"""

ORDINARY_WORDS = {
    *(
        "edit3r",
        "torch",
        "numba",
        "gsplat",
        "diffusers",
    ),  # also the name of the program, and of modules that the core looks for
    *(
        "none",
        "auto",
        "command",
        "folder",
        "network",
        "posed",
        "classical",
        "geometry",
        "refine",
        "simplify",
        "train",
    ),
    *("export", "convert", "mask", "points", "batch", "looks", "uncertainty"),
    # formats that the core itself reads or writes, and things that it speaks of
    *("ply", "spz", "sog", "splat", "glb", "nerfstudio", "video"),
    *("viewer", "sheet", "mesh", "render"),
}
"""Component names that are words of the core's own too; they count only where nothing else can be
meant.
"""


@dataclass(frozen=True)
class Module:
    """One source file."""

    name: str  # "edit3r.kit.scenes.ply"; a package's is that of its folder
    path: Path

    @cached_property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)

    @property
    def package(self) -> str:
        """The outermost package: the core or a plugin."""
        return self.name.partition(".")[0]


@dataclass(frozen=True)
class Arrow:
    """One imported name (or module), and where."""

    source: Module
    target: str  # module
    name: str  # "" for the module itself
    line: int
    at_import: bool  # False inside functions and under TYPE_CHECKING

    def __str__(self) -> str:
        what = f"{self.target}.{self.name}" if self.name else self.target
        return f"{self.source.path.relative_to(ROOT)}:{self.line} imports {what}"


@cache
def modules() -> dict[str, Module]:
    found = {}
    for folder in (ROOT, ROOT / "plugins"):
        for package in sorted(folder.glob("edit3r*/")):
            for path in sorted(package.rglob("*.py")):
                parts = path.relative_to(folder).with_suffix("").parts
                name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
                found[name] = Module(name, path)
    return found


def plugin_packages() -> set[str]:
    return {module.package for module in modules().values()} - {CORE}


@cache
def arrows() -> tuple[Arrow, ...]:
    """Every import of a project module by another."""
    return tuple(
        arrow for module in modules().values() for arrow in _arrows_from(module)
    )


def _arrows_from(module: Module) -> Iterator[Arrow]:
    late = _late_nodes(module.tree)
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            targets = [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(module, node)
            targets = [
                (f"{base}.{alias.name}", "")
                if f"{base}.{alias.name}" in modules()
                else (base, alias.name)
                for alias in node.names
            ]
        else:
            continue
        for target, name in targets:
            if target.partition(".")[0] in {CORE, *plugin_packages()}:
                yield Arrow(module, target, name, node.lineno, node not in late)


def _absolute(module: Module, node: ast.ImportFrom) -> str:
    if not node.level:
        return node.module or ""
    inside = module.name.split(".") + (
        ["__init__"] if module.path.name == "__init__.py" else []
    )
    return ".".join([*inside[: -node.level], *([node.module] if node.module else [])])


def _late_nodes(tree: ast.Module) -> set[ast.AST]:
    """Nodes that do not run when the module is imported."""
    late: set[ast.AST] = set()
    for node in ast.walk(tree):
        typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(
            node.test
        )
        if typing_only or isinstance(
            node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
        ):
            late.update(ast.walk(node))
    return late


# ---- what may import what ----


def test_the_core_imports_no_plugin():
    wrong = [
        str(arrow)
        for arrow in arrows()
        if arrow.source.package == CORE and arrow.target.split(".")[0] != CORE
    ]
    assert not wrong, "\n".join(wrong)


def test_no_imports_in_circles():
    graph = {name: set() for name in modules()}
    for arrow in arrows():
        if (
            arrow.at_import
            and arrow.target in graph
            and arrow.target != arrow.source.name
        ):
            graph[arrow.source.name].add(arrow.target)
    circles = [" -> ".join([*circle, circle[0]]) for circle in _circles(graph)]
    assert not circles, "\n".join(circles)


def _circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """One circle through each group of modules that reach each other."""
    reach = {name: _reachable(graph, name) for name in graph}
    groups = {
        frozenset(other for other in reach[name] if name in reach[other])
        for name in graph
        if name in reach[name]
    }
    return [_path_back(graph, group) for group in sorted(groups, key=sorted)]


def _reachable(graph: dict[str, set[str]], start: str) -> set[str]:
    seen, left = set(), list(graph[start])
    while left:
        name = left.pop()
        if name not in seen:
            seen.add(name)
            left += graph[name]
    return seen


def _path_back(graph: dict[str, set[str]], group: frozenset[str]) -> list[str]:
    start = min(group)
    paths = [[start]]
    for path in paths:  # breadth first; the list grows while it is walked
        for name in sorted(graph[path[-1]] & group):
            if name == start:
                return path
            if name not in path:
                paths.append([*path, name])
    return [start]


def test_plugins_talk_through_the_registry_and_the_core():
    between = [
        arrow
        for arrow in arrows()
        if arrow.source.package != CORE
        and arrow.target.split(".")[0] not in (CORE, arrow.source.package)
    ]
    statements = sorted(
        {f"{arrow.source.path.relative_to(ROOT)}:{arrow.line}" for arrow in between}
    )
    assert len(statements) <= MAX_IMPORTS_BETWEEN_PLUGINS, "\n".join(map(str, between))
    private = [
        str(arrow)
        for arrow in between
        if re.search(r"(^|\.)_", f"{arrow.target}.{arrow.name}")
    ]
    assert not private, "\n".join(private)


STEPS = "edit3r.running.steps"


def test_nothing_but_the_loop_assembles_a_run():
    """Every door (command line, Python, batch, app) builds a RunJob and calls `run`."""
    wrong = [
        str(arrow)
        for arrow in arrows()
        if arrow.target.startswith(STEPS) and arrow.source.name != "edit3r.running.run"
    ]
    assert not wrong, "\n".join(wrong)


# ---- what the core may not know ----


WORDS_OF_SENTENCES = "edit3r.wishes.vocabulary"
"""Words that people write, "recolor" and "center" among them; no component is named there."""


def test_the_core_names_no_plugin_and_no_component():
    """Docstrings may give examples; the names a run begins with are in
    edit3r/running/defaults.yaml.
    """
    components = {offer.component.name for offer in default_registry().offers()}
    qualified = {offer.qualified_name for offer in default_registry().offers()}
    told = components - ORDINARY_WORDS
    either = "|".join(map(re.escape, sorted(told | qualified, key=len, reverse=True)))
    pattern = re.compile(rf"(?<![\w-])({either})(?![\w-]|\.\w)")  # not as a file's name
    packages = re.compile(rf"\b({'|'.join(sorted(plugin_packages()))})\b")
    wrong = []
    for module in modules().values():
        if module.package == CORE and module.name != WORDS_OF_SENTENCES:
            for line, text in _texts(module):
                for name in {*pattern.findall(text), *packages.findall(text)}:
                    wrong.append(
                        f"{module.path.relative_to(ROOT)}:{line} names {name!r} in {text[:60]!r}"
                    )
    assert not wrong, "\n".join(wrong)


def _texts(module: Module) -> Iterator[tuple[int, str]]:
    """String constants that are no docstrings."""
    plain = {
        id(node.value) for node in ast.walk(module.tree) if isinstance(node, ast.Expr)
    }
    for node in ast.walk(module.tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in plain
        ):
            yield node.lineno, node.value


# ---- how much there is to read ----


def tokens_of(text: str) -> int:
    """Tokens of Python that a reader meets: without comments, docstrings and line ends."""
    count, at_statement = 0, True
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in LAYOUT:
            at_statement = at_statement or token.type in STATEMENT_ENDS
        elif not (at_statement and token.type == tokenize.STRING):
            count, at_statement = count + 1, False
    return count


LAYOUT = {
    tokenize.COMMENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
    tokenize.INDENT,
    tokenize.NEWLINE,
    tokenize.NL,
}
STATEMENT_ENDS = {tokenize.DEDENT, tokenize.INDENT, tokenize.NEWLINE}


@pytest.mark.parametrize("place", MAX_TOKENS)
def test_there_is_no_more_to_read_than_the_budget(place):
    files = [*(ROOT / place).rglob("*.py")]
    tokens = sum(tokens_of(file.read_text(encoding="utf-8")) for file in files)
    assert tokens <= MAX_TOKENS[place], f"{tokens} tokens in {len(files)} files"


def test_one_class_name_is_one_thing():
    """Private classes and the `Settings` inside components do not count."""
    homes: dict[str, list[str]] = {}
    for module in modules().values():
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(module.name)
    twice = {name: places for name, places in homes.items() if len(places) > 1}
    assert not twice, twice


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    """Every function but numba's kernels, with its full name."""
    for module in modules().values():
        for node in ast.walk(module.tree):
            decorators = " ".join(
                ast.unparse(decorator)
                for decorator in getattr(node, "decorator_list", ())
            )
            compiled = COMPILED_BY & set(re.findall(r"\w+", decorators))
            if isinstance(node, ast.FunctionDef) and not compiled:
                yield f"{module.name}.{node.name}", node


def test_functions_have_few_parameters():
    counts = {name: _parameters(node) for name, node in functions()}
    wide = {name: count for name, count in counts.items() if count > MAX_PARAMETERS}
    assert set(wide) == MANY_PARAMETERS, wide


def _parameters(node: ast.FunctionDef) -> int:
    """Parameters that a caller may give, without self, cls, and the ctx of torch's autograd."""
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    names = [arg.arg for arg in given]
    return len(names) - (names[:1] in (["self"], ["cls"], ["ctx"]))


# ---- what a run goes through ----

ENTERED = """
import inspect, sys, threading
files = set()

def note(frame, event, _):
    code = frame.f_code
    # a function, not the body of a module or class
    if event == "call" and code.co_flags & inspect.CO_OPTIMIZED:
        files.add(code.co_filename)

from edit3r.cli.main import main
threading.setprofile(note)
sys.setprofile(note)
failed = main(["run", "--size", "64", "--frames", "2", "--quiet", "--out", sys.argv[1]])
sys.setprofile(None)
print(*sorted(files), sep="\\n")
sys.exit(failed)
"""


def test_the_default_run_enters_few_files(tmp_path):
    """Files of the project in which a function is called, on the photos that are packaged."""
    done = subprocess.run(
        [sys.executable, "-c", ENTERED, str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    known = {str(module.path): module.name for module in modules().values()}
    entered = sorted(known[file] for file in done.stdout.splitlines() if file in known)
    assert 20 < len(entered) <= MAX_FILES_OF_A_RUN, (
        f"{len(entered)} files:\n" + "\n".join(entered)
    )
