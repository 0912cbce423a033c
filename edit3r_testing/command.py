"""Contract of a command."""

import argparse
import contextlib
import io

from edit3r.cli.main import Parser, parse, parser_of
from edit3r.contract.command import Command
from edit3r.contract.errors import Edit3rError
from edit3r_testing.contract import Contract

DECLARE = """
from edit3r.cli.main import Parser
from edit3r.loading.registry import default_registry
default_registry({files!r}).build("command", {name!r}).add_arguments(Parser(prog="edit3r"))
"""


class CommandContract(Contract):
    """Declares its arguments cheaply, explains itself, and refuses in one sentence."""

    kind = "command"
    subject: Command
    wrong_arguments: tuple[str, ...] = ("--surely-not-an-option",)

    def parser(self) -> Parser:
        """The parser with the command's arguments, as the program makes it."""
        return self.call(parser_of, self.subject, self.component or "command")

    def test_arguments_are_declared_without_importing_torch(self) -> None:
        """`edit3r NAME --help` must be quick: import in `main` what it needs."""
        if self.offer is None:
            return
        files = tuple(map(str, self.plugin_files))
        code = DECLARE.format(files=files, name=self.offer.qualified_name)
        self.require_light(
            "declaring its arguments", code, "move that import into main()"
        )

    def test_help_works_and_explains_every_argument(self) -> None:
        parser = self.parser()
        said = io.StringIO()

        def shown() -> object:
            try:
                with contextlib.redirect_stdout(said):
                    return parse(parser, ["--help"])
            except SystemExit as left:
                return left.code

        code = self.call(shown)
        self.require(
            not code and "usage:" in said.getvalue(),
            f"--help printed no usage, exit code {code}; leave it to the parser.",
        )
        for action in parser._actions:
            # Each step of a command explains itself.
            has_steps = isinstance(action, argparse._SubParsersAction)
            self.require(
                action.help or has_steps,
                f"argument {action.dest!r} has no help; say what it is.",
            )

    def test_wrong_arguments_end_with_exit_code_2_and_one_sentence(self) -> None:
        wrong = self.wrong_arguments
        try:
            parse(self.parser(), list(wrong))
        except Edit3rError as error:
            self.require(
                error.exit_code == 2 and "\n" not in str(error),
                f"{wrong} ended with {error!r}; exit code 2 and one line are expected.",
            )
        except (Exception, SystemExit) as error:
            self.require(
                False,
                f"{wrong} raised {error!r}; do not replace the parser or its error().",
            )
        else:
            self.require(
                False, f"{wrong} were accepted; do not take every argument there is."
            )
