"""The command's contract finds every way of breaking it."""

import pytest

from edit3r.cli.main import COMMANDS, find_command
from edit3r.contract.command import Command
from edit3r_testing import CommandContract


class Silent(Command):
    """An argument without help."""

    def add_arguments(self, parser):
        parser.add_argument("scene")

    def main(self, args):
        return 0


class Unhelpful(Command):
    """Replaces --help."""

    def add_arguments(self, parser):
        parser.print_help = lambda file=None: None

    def main(self, args):
        return 0


class Greedy(Command):
    """Takes every argument."""

    def add_arguments(self, parser):
        parser.parse_known_intermixed_args = lambda args=None, namespace=None: (
            namespace,
            [],
        )
        parser.parse_intermixed_args = lambda args=None, namespace=None: namespace

    def main(self, args):
        return 0


class Leaving(Command):
    """Ends the process by itself."""

    def add_arguments(self, parser):
        parser.error = lambda message: parser.exit(2, f"{message}\n")

    def main(self, args):
        return 0


HELP = "test_help_works_and_explains_every_argument"
WRONG = "test_wrong_arguments_end_with_exit_code_2_and_one_sentence"
CASES = {
    "a silent argument": (Silent, HELP, "has no help"),
    "no help": (Unhelpful, HELP, "printed no usage"),
    "taking everything": (Greedy, WRONG, "do not take every argument"),
    "leaving by itself": (Leaving, WRONG, "do not replace the parser"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_command_broken_by(case, complaint):
    command, claim, advice = CASES[case]
    assert advice in complaint(CommandContract, lambda: command(None), claim)


@pytest.mark.slow
def test_a_command_that_declares_with_torch_is_told(tmp_path):
    (tmp_path / "heavy_command.py").write_text(
        "from edit3r import Component, hookimpl\n"
        "from edit3r.contract.command import Command\n\n\n"
        "class Heavy(Command):\n"
        '    """Heavy."""\n\n'
        "    def add_arguments(self, parser):\n        import torch\n\n"
        "    def main(self, args):\n        return 0\n\n\n"
        "@hookimpl\ndef register_commands():\n"
        '    return [Component("heavy", "heavy_command:Heavy", "imports torch too early")]\n'
    )
    bound = type(
        "Bound",
        (CommandContract,),
        {"component": "heavy", "plugin_files": (tmp_path / "heavy_command.py",)},
    )
    with pytest.raises(AssertionError, match="declaring its arguments imports torch"):
        bound().test_arguments_are_declared_without_importing_torch()


@pytest.mark.parametrize("name", [component.name for component in COMMANDS])
def test_the_commands_of_the_core_keep_the_contract(name):
    bound = type(
        "Bound", (CommandContract,), {"build": lambda self: find_command(name)}
    )
    for claim in (HELP, WRONG):
        getattr(bound(), claim)()
