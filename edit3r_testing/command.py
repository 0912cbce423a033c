"""Contract of a command."""

import argparse
import contextlib
import io

from edit3r.cli.main import Parser, parse
from edit3r.contract.command import Command
from edit3r.errors import Edit3rError
from edit3r_testing.contract import Contract

DECLARE = """
from edit3r.cli.main import Parser
from edit3r.plugins.registry import default_registry
default_registry({files!r}).build("command", {name!r}).add_arguments(Parser(prog="edit3r"))
"""


class CommandContract(Contract):
    """Declares its arguments without importing anything heavy, explains itself, and refuses in one
    sentence.
    """

    kind = "command"
    subject: Command
    wrong_arguments: tuple[str, ...] = ("--surely-not-an-option",)

    def parser(self) -> Parser:
        """The parser with the command's arguments, as the program makes it."""
        parser = Parser(
            prog=f"edit3r {self.component or 'command'}",
            description=self.subject.__doc__,
        )
        self.call("add_arguments()", self.subject.add_arguments, parser)
        return parser

    def test_arguments_are_declared_without_importing_torch(self) -> None:
        """`edit3r NAME --help` must be quick: import in `main` what it needs."""
        if self.offer is None:
            return
        files = tuple(str(file) for file in self.plugin_files)
        code = DECLARE.format(files=files, name=self.offer.qualified_name)
        self.require_light(
            "declaring its arguments", code, "move that import into main()"
        )

    def test_help_works_and_explains_every_argument(self) -> None:
        parser, said = self.parser(), io.StringIO()
        try:
            with contextlib.redirect_stdout(said):
                self.call("--help", parse, parser, ["--help"])
        except SystemExit as left:
            self.require(
                not left.code,
                f"--help ended with exit code {left.code}; leave it to the parser.",
            )
        self.require(
            "usage:" in said.getvalue(),
            "--help printed no usage; leave it to the parser.",
        )
        steps = argparse._SubParsersAction  # each step of it explains itself
        silent = [
            action.dest
            for action in parser._actions
            if not action.help and not isinstance(action, steps)
        ]
        self.require(not silent, f"argument {silent[:1]} has no help; say what it is.")

    def test_wrong_arguments_end_with_exit_code_2_and_one_sentence(self) -> None:
        try:
            parse(self.parser(), list(self.wrong_arguments))
        except Edit3rError as error:
            plain = error.exit_code == 2 and "\n" not in str(error)
            self.require(
                plain,
                f"{self.wrong_arguments} ended with {error!r}; exit code 2 and one line are "
                "expected.",
            )
        except (Exception, SystemExit) as error:
            self.require(
                False,
                f"{self.wrong_arguments} raised {error!r}; do not replace the parser or its "
                "error().",
            )
        else:
            self.require(
                False,
                f"{self.wrong_arguments} were accepted; do not take every argument there is.",
            )
