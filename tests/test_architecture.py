"""The rules of the house: what may import what, how long things may get, and what the core may not
know.

Read from the sources alone (ast); nothing is imported but the registry, for the names of the
components.
"""

import ast
import json
import re
import runpy
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import pytest

from edit3r import default_registry

ROOT = Path(__file__).parents[1]
CORE = "edit3r"
TESTING = "edit3r_testing"  # part of the house: it may look behind the promised names

MAX_PARAMETERS = 8
MAX_FILES_OF_A_RUN = 170  # 20 of them plugins that say what they offer

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
        "plugins",
        "folder",
        "mp4",
        "network",
        "model",
        "posed",
        "classical",
        "geometry",
        "limits",
        "refine",
        "simplify",
        "train",
    ),
    *(
        "export",
        "mask",
        "points",
        "batch",
        "looks",
        "style",  # of an HTML element
        "uncertainty",
        "weights",
    ),
    # formats that the core itself reads or writes, and things that it speaks of
    *("ply", "spz", "sog", "splat", "glb", "nerfstudio", "colmap", "video", "mp4"),
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
                yield Arrow(module, target, name, node.lineno)


def _absolute(module: Module, node: ast.ImportFrom) -> str:
    if not node.level:
        return node.module or ""
    inside = module.name.split(".") + (
        ["__init__"] if module.path.name == "__init__.py" else []
    )
    return ".".join([*inside[: -node.level], *([node.module] if node.module else [])])


@pytest.fixture(scope="module", autouse=True)
def every_source_is_read():
    """Reading them is no test's own time."""
    arrows()


# ---- what may import what ----


LAYERS = {
    "version": 0,
    "contract": 1,
    "kit": 2,
    "loading": 3,
    "running": 4,
    "api": 5,
    "cli": 6,
    "__main__": 7,
}
"""Rooms of the core, lowest first; `edit3r` itself, which shows their names, lies above all."""


def layer(module: str) -> int:
    """The layer of a module of the core."""
    rooms = module.split(".")
    return LAYERS[rooms[1]] if len(rooms) > 1 else max(LAYERS.values()) + 1


@pytest.mark.slow
def test_the_core_imports_no_plugin():
    wrong = [
        str(arrow)
        for arrow in arrows()
        if arrow.source.package == CORE and arrow.target.split(".")[0] != CORE
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_arrows_go_down_only():
    """Late imports and those for types count as well."""
    up = [
        str(arrow)
        for arrow in arrows()
        if arrow.source.package == CORE
        and layer(arrow.target) > layer(arrow.source.name)
    ]
    assert not up, "\n".join(up)


def test_no_file_imports_in_circles():
    """Late imports and those for types count as well."""
    graph = {name: set() for name in modules()}
    for arrow in arrows():
        if arrow.target in graph and arrow.target != arrow.source.name:
            graph[arrow.source.name].add(arrow.target)
    circles = [" -> ".join([*circle, circle[0]]) for circle in _circles(graph)]
    assert not circles, "\n".join(circles)


def test_no_benchmark_imports_in_circles():
    """They stand in one folder and import each other by file name."""
    files = {file.stem: file for file in (ROOT / "benchmarks").glob("*.py")}
    graph = {
        name: {
            target
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
            for target in _plain_imports(node)
            if target in files
        }
        for name, file in files.items()
    }
    assert not _circles(graph)


def _plain_imports(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or ""] if isinstance(node, ast.ImportFrom) else []


def test_no_rooms_import_in_circles():
    """Rooms: the folders of the core, and those of the kit."""
    graph: dict[str, set[str]] = {}
    for arrow in arrows():
        source, target = room(arrow.source.name), room(arrow.target)
        if source and target and source != target:
            graph.setdefault(source, set()).add(target)
            graph.setdefault(target, set())
    circles = [" -> ".join([*circle, circle[0]]) for circle in _circles(graph)]
    assert not circles, "\n".join(circles)


def room(module: str) -> str:
    """The room that a module of the core lies in; "" for a plugin's and for `edit3r` itself."""
    parts = module.split(".")
    if parts[0] != CORE or len(parts) < 2:
        return ""
    return ".".join(parts[:3] if parts[1] == "kit" else parts[:2])


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


def test_plugins_import_of_another_plugin_its_api_alone():
    between = [
        str(arrow)
        for arrow in arrows()
        if arrow.source.package not in (CORE, TESTING)
        and arrow.target.split(".")[0] not in (CORE, TESTING, arrow.source.package)
        and arrow.target.split(".")[1:] != ["api"]
    ]
    assert not between, "\n".join(between)


SURFACE = runpy.run_path(str(ROOT / "docs/surface.py"))


def test_the_page_lists_the_promised_names():
    """After a change: python docs/surface.py --write; what was promised leaves with a warning."""
    listed = SURFACE["PAGE"].read_text(encoding="utf-8").split()
    assert listed == SURFACE["promised"]()


def test_plugins_use_promised_names_only():
    promised = set(SURFACE["promised"]())
    packages = {name.partition(":")[0] for name in promised}
    wrong = [
        str(arrow)
        for arrow in arrows()
        if arrow.source.package not in (CORE, TESTING)
        and arrow.target.split(".")[0] == CORE
        and f"{arrow.target}:{arrow.name}" not in promised
        and not (arrow.name == "" and arrow.target in packages)
    ]
    assert not wrong, "\n".join(wrong)


STEPS = "edit3r.running.steps"


def test_nothing_but_the_pipeline_assembles_a_run():
    """Every door (command line, Python, batch, app) builds a RunJob and calls `run`."""
    wrong = [
        str(arrow)
        for arrow in arrows()
        if arrow.target.startswith(STEPS)
        and arrow.source.name != "edit3r.running.pipeline"
    ]
    assert not wrong, "\n".join(wrong)


# ---- what the core may not know ----


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
        if module.package == CORE:
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


@pytest.mark.slow
def test_functions_have_few_parameters():
    counts = {name: _parameters(node) for name, node in functions()}
    wide = {name: count for name, count in counts.items() if count > MAX_PARAMETERS}
    assert set(wide) == MANY_PARAMETERS, wide


def _parameters(node: ast.FunctionDef) -> int:
    """Parameters that a caller may give, without self, cls, and the ctx of torch's autograd."""
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    names = [arg.arg for arg in given]
    return len(names) - (names[:1] in (["self"], ["cls"], ["ctx"]))


SHAPE = re.compile(r'\[[\w.]+, "[^"]*$')
"""What stands before a name in a shape, such as `Float[Tensor, "gaussian 3"]`."""


def test_no_name_is_undefined():
    """ruff's F821 without jaxtyping's shapes, whose dimensions look like names to it."""
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "ruff",
            "check",
            "--select=F821",
            "--output-format=json",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    undefined = []
    for found in json.loads(done.stdout):
        file, place = Path(found["filename"]), found["location"]
        line = file.read_text(encoding="utf-8").splitlines()[place["row"] - 1]
        if not SHAPE.search(line[: place["column"] - 1]):
            undefined.append(f"{file}:{place['row']}: {found['message']}")
    assert not undefined, undefined


# ---- what a run goes through ----

ENTERED = """
import inspect, os, pathlib, sys, threading
import skimage
files, opened = set(), []
data = pathlib.Path(skimage.__file__).parent / "data"
photos = {str(one) for one in data.glob("motorcycle_*t.png")}

def hear(event, arguments):
    if event == "open" and str(arguments[0]) in photos:
        opened.append(os.path.basename(str(arguments[0])))

def note(frame, event, _):
    code = frame.f_code
    # a function, not the body of a module or class
    if event == "call" and code.co_flags & inspect.CO_OPTIMIZED:
        files.add(code.co_filename)

from edit3r.cli.main import main
sys.addaudithook(hear)
threading.setprofile(note)
sys.setprofile(note)
failed = main(["run", "--size", "64", "--frames", "2", "--quiet", "--out", sys.argv[1]])
sys.setprofile(None)
print(*sorted(files), *opened, sep="\\n")
sys.exit(failed)
"""


@pytest.mark.slow
def test_the_default_run_enters_few_files_and_opens_each_photo_twice(tmp_path):
    """Files of the project in which a function is called, on the photos that are packaged: their
    headers are read first, then their pixels.
    """
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
    lines = done.stdout.splitlines()
    opened = Counter(line for line in lines if line.startswith("motorcycle_"))
    assert opened == {"motorcycle_left.png": 2, "motorcycle_right.png": 2}
