"""The interface of a command, apart from the others so that `edit3r --help` loads no torch."""

import argparse
from abc import ABC, abstractmethod
from pathlib import Path

from edit3r.config import Settings


def scene_file(text: str) -> Path:
    """Argument type of a saved scene: its file, or the run folder that holds a `scene.ply`."""
    path = Path(text)
    return path / "scene.ply" if path.is_dir() else path


def add_plugin_option(parser: argparse.ArgumentParser) -> None:
    """Add `--plugin FILE`, whose values a registry takes as local files."""
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE",
        help="also load this local plugin file",
    )


class Command(ABC):
    """One command of the program, `edit3r NAME`.

    The summary of its component is its line in `edit3r --help`.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    @abstractmethod
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's arguments. Heavy modules are imported in `main`, not here."""

    @abstractmethod
    def main(self, args: argparse.Namespace) -> int | None:
        """Do the work and return the exit code; None means 0. What the user can mend is raised from
        `edit3r.errors`.
        """


def add_trust_flag(parser: argparse.ArgumentParser) -> None:
    """Add the consent to programs and addresses that a file of settings names."""
    parser.add_argument(
        "--trust-config",
        action="store_true",
        help="let files of settings name programs to run and addresses to send data to",
    )
