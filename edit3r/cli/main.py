"""Find the command, parse its arguments, turn errors into one sentence and an exit code."""

import argparse
import importlib
import os
import re
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import takewhile
from typing import TYPE_CHECKING, NoReturn

from edit3r.contract.component import Component
from edit3r.contract.errors import Edit3rError, as_known, did_you_mean
from edit3r.kit.files.names import require_there
from edit3r.kit.files.text import printable
from edit3r.version import __version__

if TYPE_CHECKING:
    from edit3r.contract.command import Command

COMMANDS = (
    Component(
        "run",
        "edit3r.cli.run:RunCommand",
        "edit photos of a scene and reconstruct them in 3D",
    ),
    Component(
        "list-plugins",
        "edit3r.cli.list_plugins:ListPluginsCommand",
        "list installed plugins and their components, what they lack, and which failed and why",
    ),
    Component(
        "describe",
        "edit3r.cli.describe:DescribeCommand",
        "show a component's settings, licence and needs, and YAML to paste into a configuration",
    ),
    Component(
        "schema",
        "edit3r.cli.schema:SchemaCommand",
        "print the JSON schema of a command's configuration file, for an editor",
    ),
)
"""The core's own commands; all others come from plugins."""

SETTING = re.compile(r"[\w.-]+")  # --out, or editor.path of --set
MAX_SENTENCE = 4000  # characters of an error: what was given may be megabytes


class UsageError(Edit3rError):
    """Arguments that no command takes: exit code 2."""


class Parser(argparse.ArgumentParser):
    """An argument parser that raises instead of exiting, and suggests the option that was meant."""

    def error(self, message: str) -> NoReturn:
        hint = ""
        if unknown := re.match("unrecognized arguments: ([^ =]*)", message):
            options = [one for action in self._actions for one in action.option_strings]
            hint = did_you_mean(unknown[1], options)
        if wrong := re.search("invalid choice: '([^']*)'", message):
            choices = [one for action in self._actions for one in action.choices or ()]
            hint = did_you_mean(wrong[1], map(str, choices))
        raise UsageError(f"{message}.{hint} See '{self.prog} --help'.")


def main(argv: Sequence[str] | None = None, interruptions: Sequence[int] = ()) -> int:
    """Run one command and return the exit code.

    0: done, 1: failed, 2: wrong use or unusable input, 3: a question, 130: interrupted.
    `interruptions` fills when the user presses Ctrl-C; any error after that is taken for its
    consequence.
    """
    argv = [at_home(one) for one in (sys.argv[1:] if argv is None else argv)]
    try:
        code = _dispatch(argv)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader of our output went away: `edit3r list-plugins | head`. Python writes what is
        # left once more on leaving, which would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (Exception, KeyboardInterrupt) as error:
        if "--debug" in argv:
            traceback.print_exc()
        if interruptions or not isinstance(error, Exception):
            _tell("interrupted; nothing half-written was left under its final name.")
            return 130
        known = as_known(error)
        _tell(str(known))
        return known.exit_code


def at_home(argument: str) -> str:
    """The argument with the user's folder for ~, which shells leave after = and Windows always."""
    setting, separator, path = argument.partition("=")
    if separator and SETTING.fullmatch(setting):
        return f"{setting}={os.path.expanduser(path)}" if path[:1] == "~" else argument
    return os.path.expanduser(argument) if argument[:2] in ("~/", "~\\") else argument


def _tell(sentence: str) -> None:
    line = " ".join(sentence.split())
    if len(line) > MAX_SENTENCE:
        half = MAX_SENTENCE // 2
        line = f"{line[:half]} ... {line[-half:]}"
    print(f"edit3r: {printable(line)}", file=sys.stderr)


def _dispatch(argv: list[str]) -> int:
    """Find the command among the core's own and those of plugins, and run it."""
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0 if argv else 2
    if argv[0] in ("-V", "--version"):
        print(f"edit3r {__version__}")
        return 0
    name, *rest = argv
    # before pydantic and torch are imported; a preview's own file is asked about first
    if name == "run" and "--preview" not in rest:
        for photo in takewhile(lambda one: not one.startswith("-"), rest):
            require_there(photo)
    command = find_command(name)
    with _named_after(command):
        return command.main(parse(parser_of(command, name), rest)) or 0


@contextmanager
def _named_after(command: "Command") -> Iterator[None]:
    """Name a plugin's command in an error that was not meant for the user."""
    try:
        yield
    except (Edit3rError, OSError):
        raise
    except Exception:
        if not hasattr(command, "offer"):
            raise
        from edit3r.kit.checks import errors_named_after  # which imports torch

        with errors_named_after(command):
            raise


def parser_of(command: "Command", name: str) -> Parser:
    """The parser with the command's arguments, and with those of every command."""
    parser = Parser(prog=f"edit3r {name}", description=command.__doc__)
    command.add_arguments(parser)
    parser.add_argument(
        "--debug", action="store_true", help="show the full traceback of an error"
    )
    return parser


def find_command(name: str) -> "Command":
    """Build the command called `name`; plugins are loaded only for one that the core lacks."""
    from edit3r.contract.settings import Settings
    from edit3r.loading.registry import default_registry

    commands = {component.name: component for component in COMMANDS}
    if name in commands:
        module, _, attribute = commands[name].target.partition(":")
        return getattr(importlib.import_module(module), attribute)(Settings())
    registry = default_registry()
    known = [*commands, *(offer.component.name for offer in registry.offers("command"))]
    if name not in known and ":" not in name:
        raise UsageError(
            f"no command {name!r}.{did_you_mean(name, known)} Commands: "
            f"{', '.join(sorted(known))}.{registry.failed()}"
        )
    return registry.build("command", name)


def parse(parser: argparse.ArgumentParser, arguments: list[str]) -> argparse.Namespace:
    """Parse with options and positionals in any order, but for commands with steps of their own."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return parser.parse_args(arguments)
    # the other way forgets it, and takes what follows for options
    if "--" in arguments:
        return parser.parse_args(arguments)
    return parser.parse_intermixed_args(arguments)


def _summaries() -> dict[str, str]:
    """By the name of each command."""
    # Not the registry, whose settings take a tenth of a second to load.
    from edit3r.loading.load import load_plugins

    summaries = {one.name: one.summary for one in COMMANDS}
    for offer in load_plugins().offers:
        if offer.kind == "command":
            summaries.setdefault(offer.component.name, offer.component.summary)
    return summaries


def _overview() -> str:
    """The text of `edit3r --help`: every command with its summary."""
    summaries = _summaries()
    width = max(map(len, summaries))
    listed = [f"  {name:<{width}}  {text}" for name, text in sorted(summaries.items())]
    return "\n".join(
        [
            f"edit3r {__version__}: edit 3D scenes from a few photos.",
            "",
            "usage: edit3r COMMAND [options]",
            "",
            *listed,
            "",
            "Start with: edit3r run",
            "Each command explains itself: edit3r run --help",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
