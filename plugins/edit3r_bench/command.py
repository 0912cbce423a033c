"""`edit3r bench build|run|report`: the editing benchmark.

build    photos | generated scenes        -> manifest            photos, generated
run      manifest, editor, reconstructor  -> results, images     run
report   folders of results               -> tables, a page      report
"""

import argparse
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.kit.command.flags import REPEATED, add_common, add_trust_flag
from edit3r.running import add_flags
from edit3r_bench.options import BuildOptions, RunOptions

if TYPE_CHECKING:
    from edit3r.contract.settings import Settings


class BenchCommand(Command):
    """The editing benchmark: build its manifest, run methods on it, report them."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the steps and their options."""
        parser.set_defaults(print_help=parser.print_help)
        steps = parser.add_subparsers(dest="step", metavar="build|run|report")
        for declare in (_build, _run, _report):
            about = declare.__doc__
            name = declare.__name__.removeprefix("_")
            step = steps.add_parser(name, help=about, description=about)
            declare(step)
            debug = "show the full traceback of an error"
            step.add_argument("--debug", action="store_true", help=debug)

    def configuration(self) -> "type[Settings]":
        from edit3r_bench.method import BenchConfig

        return BenchConfig

    def main(self, args: argparse.Namespace) -> int | None:
        """Do the step that was named."""
        if args.step is None:
            args.print_help()
            return 2
        # Heavy modules load now, so that the command line is parsed without them.
        from edit3r_bench import steps

        return getattr(steps, args.step)(args)


def _build(parser: argparse.ArgumentParser) -> None:
    """Make a benchmark from folders of photos, or from generated scenes."""
    folder = "a folder of scenes: one folder of photos each"
    parser.add_argument("folder", nargs="?", metavar="FOLDER", help=folder)
    add_flags(parser, BuildOptions)
    add_common(parser, "of generator, detector, segmenter or truth")


def _run(parser: argparse.ArgumentParser) -> None:
    """Take one method, or all of a configuration, through a benchmark."""
    add = parser.add_argument
    add("manifest", metavar="MANIFEST", help="JSON file of edit3r bench build")
    out = "folder for results; with several methods one folder each inside it"
    add("--out", required=True, metavar="DIR", help=out)
    add_flags(parser, RunOptions)
    config = "YAML list of methods, or the name of a shipped one such as bench/offline"
    add("--config", metavar="FILE", help=config)
    add_trust_flag(parser)
    only = "only this method of the configuration"
    add("--only", metavar="LABEL", help=only, **REPEATED)
    add_common(parser, "such as poses=false; LABEL.poses=... with --config")


def _report(parser: argparse.ArgumentParser) -> None:
    """Write tables and one page from the results of several methods."""
    add = parser.add_argument
    folders = "folders of edit3r bench run, or folders that hold such folders"
    add("folders", nargs="+", metavar="DIR", help=folders)
    out = "folder for the report (default: report/ in the first folder)"
    add("--out", metavar="DIR", help=out)
    pictures = "most edits shown with images (default 20)"
    add("--pictures", type=int, default=20, metavar="N", help=pictures)
    add_common(parser)
