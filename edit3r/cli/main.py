"""Entry point of `edit3r`: find the command, parse its arguments, turn errors into one sentence and
an exit code.
"""

import argparse
import gc
import importlib
import os
import re
import sys
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

import edit3r
from edit3r.cli import COMMANDS
from edit3r.errors import Edit3rError, as_known, suggest

if TYPE_CHECKING:
    from edit3r.contract.command import Command


class UsageError(Edit3rError):
    """Wrong arguments."""


class Parser(argparse.ArgumentParser):
    """An argument parser that raises instead of exiting, and suggests the option that was meant."""

    def error(self, message: str) -> None:
        options = [
            option for action in self._actions for option in action.option_strings
        ]
        given = message.removeprefix("unrecognized arguments: ").split(" ")[0]
        hint = (
            suggest(given.split("=")[0], options)
            if message.startswith("unrecognized")
            else ""
        )
        if wrong := re.search("invalid choice: '([^']*)'", message):
            hint = suggest(
                wrong[1],
                [
                    str(choice)
                    for action in self._actions
                    for choice in action.choices or ()
                ],
            )
        raise UsageError(f"{message}.{hint} See '{self.prog} --help'.")


def program() -> int:
    """`main` as all that a process does: the command `edit3r`.

    Python looks for cycles among what importing torch leaves dozens of times, though all of it
    stays, and once more on leaving: 0.7 of the 2.7 seconds of a process that only imports it.
    """
    gc.set_threshold(10_000)
    try:
        return main()
    finally:
        gc.freeze()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 failed, 2 wrong use or unusable input, 130
    interrupted.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in argv
    try:
        code = _dispatch(argv)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print(
            "edit3r: interrupted; nothing half-written was left under its final name.",
            file=sys.stderr,
        )
        return 130
    except (
        BrokenPipeError
    ):  # the reader of our output went away: `edit3r list-plugins | head`
        # Python writes what is left once more on leaving, which would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if debug:
            traceback.print_exc()
        known = as_known(error)
        sentence = " ".join(str(known).split())
        # A file name may be no UTF-8, and whoever reads our errors may take nothing else.
        print(
            f"edit3r: {sentence.encode(errors='backslashreplace').decode()}",
            file=sys.stderr,
        )
        return known.exit_code


def _dispatch(argv: list[str]) -> int:
    """Find the command among the core's own and those of plugins, and run it."""
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0 if argv else 2
    if argv[0] in ("-V", "--version"):
        print(f"edit3r {edit3r.__version__}")
        return 0
    name, *rest = argv
    command = find_command(name)
    parser = Parser(prog=f"edit3r {name}", description=command.__doc__)
    command.add_arguments(parser)
    parser.add_argument(
        "--debug", action="store_true", help="show the full traceback of an error"
    )
    return command.main(parse(parser, rest)) or 0


def find_command(name: str) -> "Command":
    """Build the command called `name`; plugins are loaded only for one that the core does not
    have.
    """
    from edit3r.config import Settings
    from edit3r.plugins.registry import default_registry

    own = {component.name: component for component in COMMANDS}
    if name in own:
        module, _, attribute = own[name].target.partition(":")
        return getattr(importlib.import_module(module), attribute)(Settings())
    registry = default_registry()
    known = [*own, *(offer.component.name for offer in registry.offers("command"))]
    if name not in known and ":" not in name:
        failed = "".join(
            f" Plugin {f.plugin!r} did not load: {f.reason}." for f in registry.failures
        )
        raise UsageError(
            f"no command {name!r}.{suggest(name, known)} Commands: "
            f"{', '.join(sorted(known))}.{failed}"
        )
    return registry.build("command", name)


def parse(parser: argparse.ArgumentParser, arguments: list[str]) -> argparse.Namespace:
    """Parse with options and positionals in any order; commands with steps of their own cannot have
    that.
    """
    steps = any(
        isinstance(action, argparse._SubParsersAction) for action in parser._actions
    )
    return (
        parser.parse_args(arguments)
        if steps
        else parser.parse_intermixed_args(arguments)
    )


def _overview() -> str:
    """The text of `edit3r --help`: every command with its summary."""
    from edit3r.plugins.load import (
        load_plugins,  # not the registry, whose settings take a tenth of a second to load
    )

    offers = [offer for offer in load_plugins().offers if offer.kind == "command"]
    rows = sorted(
        {
            (c.name, c.summary)
            for c in (*COMMANDS, *(offer.component for offer in offers))
        }
    )
    width = max(len(name) for name, _ in rows)
    listed = "\n".join(f"  {name:<{width}}  {text}" for name, text in rows)
    return (
        f"edit3r {edit3r.__version__}: edit 3D scenes from a few photos.\n\n"
        "usage: edit3r COMMAND [options]\n\n"
        f"{listed}\n\n"
        "Start with: edit3r run\n"
        "Each command explains itself: edit3r run --help"
    )


if __name__ == "__main__":
    sys.exit(program())
