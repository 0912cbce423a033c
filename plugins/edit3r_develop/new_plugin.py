"""`edit3r new-plugin`: a plugin package that works at once, to change into one's own.

The texts are in `templates/` beside this file: one module per kind, what every package has around
it (settings, a test, a README), and in `starters.yaml` what differs from kind to kind.
"""

import argparse
import importlib.util
import keyword
import re
import shutil
import tempfile
from pathlib import Path
from string import Template
from typing import Any

from edit3r import __version__
from edit3r.contract.command import Command
from edit3r.contract.component import KINDS, hook_name
from edit3r.contract.errors import InputError, did_you_mean
from edit3r.contract.hookspecs import API_VERSION
from edit3r.kit.files.configs import read_yaml

TEMPLATES = Path(__file__).parent / "templates"
STARTERS: dict[str, dict[str, Any]] = read_yaml(TEMPLATES / "starters.yaml")
NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
MAX_NAME = 40


class NewPluginCommand(Command):
    """Write a working plugin package to start from."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("kind", choices=KINDS, help="kind of component")
        about = "name of the component, such as sepia or warm-light"
        parser.add_argument("name", help=about)
        about = "folder to write edit3r-NAME into (default: here)"
        parser.add_argument("--path", metavar="DIR", default=".", help=about)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import default_registry

        taken = [
            offer.plugin
            for offer in default_registry().offers(args.kind)
            if offer.component.name == args.name
        ]
        if taken:
            raise InputError(
                f"{args.kind} {args.name!r} is already offered by plugin {taken[0]!r}; choose "
                "another name."
            )
        folder = new_package(args.kind, args.name, Path(args.path))
        files = sorted(
            path.relative_to(folder) for path in folder.rglob("*") if path.is_file()
        )
        print(f"Wrote {folder}:")
        print("\n".join(f"  {file}" for file in files))
        print("Next:")
        print(
            "\n".join(f"  {step}" for step in next_steps(args.kind, args.name, folder))
        )
        return 0


def new_package(kind: str, name: str, parent: Path) -> Path:
    """Write the package into a new folder in `parent`; nothing that exists is touched."""
    if kind not in KINDS:
        raise InputError(
            f"no kind {kind!r}.{did_you_mean(kind, KINDS)} Kinds: {', '.join(KINDS)}."
        )
    check_name(name)
    folder = parent / f"edit3r-{name}"
    if folder.exists() or folder.is_symlink():
        raise InputError(
            f"{folder} exists; nothing was written. Choose another name, or --path for another "
            "place."
        )
    parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=parent, prefix=".edit3r-") as temporary:
        staged = Path(temporary) / folder.name
        for path, text in package_files(kind, name).items():
            target = staged / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")
        shutil.move(staged, folder)
    return folder


def package_files(kind: str, name: str) -> dict[str, str]:
    """Relative path to text of every file of the package."""
    words = _words(kind, name)
    package = words["package"]
    return {
        "pyproject.toml": _fill("package/pyproject.toml", words),
        "README.md": _fill("package/README.md", words),
        f"{package}/__init__.py": _fill("package/__init__.py", words),
        f"{package}/{kind}.py": _fill(f"components/{kind}.py", words),
        f"tests/test_{kind}.py": _fill("package/test_contract.py", words),
    }


def next_steps(kind: str, name: str, folder: Path) -> tuple[str, ...]:
    """Commands that install, show, use and test the new package."""
    use = Template(STARTERS[kind].get("use", "")).substitute(name=name)
    steps = (
        f'pip install -e "{folder}[test]"',
        f"edit3r describe {kind} {name}",
        use,
        f"pytest {folder}",
    )
    return tuple(step for step in steps if step)


def check_name(name: str) -> None:
    """Raise InputError unless `name` can name a component, a package and a module, all new."""
    if not NAME.fullmatch(name) or len(name) > MAX_NAME:
        raise InputError(
            f"name {name!r}: expected lower-case letters, digits and single dashes, starting with "
            f"a letter, at most {MAX_NAME} characters, such as {_nearest(name)!r}."
        )
    if keyword.iskeyword(name):
        raise InputError(f"name {name!r} is a Python keyword; choose another.")
    package = _package(name)
    if importlib.util.find_spec(package) is not None:
        raise InputError(
            f"name {name!r}: a package {package!r} is already installed; choose another name."
        )


def _nearest(name: str) -> str:
    """A valid name like the one given."""
    tidy = re.sub(
        r"[^a-z0-9]+", "-", re.sub(r"([a-z0-9])([A-Z])", r"\1-\2", name).lower()
    ).strip("-")
    tidy = tidy.lstrip("0123456789-")[:MAX_NAME].rstrip("-")
    return tidy or "my-plugin"


def _package(name: str) -> str:
    return f"edit3r_{name.replace('-', '_')}"


def _words(kind: str, name: str) -> dict[str, str]:
    """What the templates' placeholders stand for."""
    starter = STARTERS[kind]
    suffix = starter["suffix"]
    settings = starter.get("test_settings", "")
    return {
        "kind": kind,
        "name": name,
        "package": _package(name),
        "distribution": f"edit3r-{name}",
        "entry_point": name,
        "class_name": "".join(part.title() for part in name.split("-")).removesuffix(
            suffix
        )
        + suffix,
        "contract": f"{suffix}Contract",
        "summary": starter["summary"],
        "use": Template(
            starter.get("use", f"edit3r list-plugins --kind {kind} --check")
        ).substitute(name=name),
        "hook": hook_name(kind),
        "declaration": "".join(
            f"\n            {argument}," for argument in starter.get("declaration", ())
        ),
        "test_settings": f"\n    {settings}" if settings else "",
        "article": "An" if kind[0] in "aeiou" else "A",
        "api_version": str(API_VERSION),
        "edit3r_version": __version__,
    }


def _fill(template: str, words: dict[str, str]) -> str:
    return Template(
        (TEMPLATES / f"{template}.txt").read_text(encoding="utf-8")
    ).substitute(words)
