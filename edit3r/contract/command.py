"""The interface of a command, apart from the others so that `edit3r --help` loads no torch."""

import argparse
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from edit3r.contract.component import Configured

if TYPE_CHECKING:
    from edit3r.contract.settings import Settings


class Command(Configured, ABC):
    """One command of the program, `edit3r NAME`.

    The summary of its component is its line in `edit3r --help`.
    """

    @abstractmethod
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's arguments. Heavy modules are imported in `main`, not here."""

    @abstractmethod
    def main(self, args: argparse.Namespace) -> int | None:
        """Do the work; returns the exit code, None for 0. What users can mend is an Edit3rError."""

    def configuration(self) -> "type[Settings] | None":
        """The settings in the file that `--config` or the command's argument names, for `edit3r
        schema`; None where it reads no such file.
        """
        return None
