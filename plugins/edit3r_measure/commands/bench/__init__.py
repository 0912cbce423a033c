"""`edit3r bench build|run|report`: one command with three of its own."""

import argparse

from edit3r.command import Command
from edit3r_measure.commands.bench.build import BenchBuild
from edit3r_measure.commands.bench.report import BenchReport
from edit3r_measure.commands.bench.run import BenchRun

STEPS = {"build": BenchBuild, "run": BenchRun, "report": BenchReport}


class BenchCommand(Command):
    """The editing benchmark: build its manifest, run methods on it, report them."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        steps = parser.add_subparsers(dest="step", required=True, metavar="build|run|report")
        for name, step in STEPS.items():
            own = steps.add_parser(name, help=step.__doc__, description=step.__doc__)
            step(self.settings).add_arguments(own)

    def main(self, args: argparse.Namespace) -> int | None:
        return STEPS[args.step](self.settings).main(args)
