"""`edit3r bench report`: tables, plots and one page from the results of several methods."""

import argparse
from pathlib import Path

from edit3r.command import Command


class BenchReport(Command):
    """`edit3r bench report`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("folders", nargs="+", metavar="DIR", help="folders of edit3r bench run, or folders of such")
        add("--out", metavar="DIR", help="folder for the report (default: report/ in the first folder)")
        add("--first", metavar="LABEL", help="the method that the others are compared with (default: the first found)")
        add("--pictures", type=int, default=20, metavar="N", help="most edits shown with pictures (default 20)")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.console import StageConsole
        from edit3r.errors import SettingsError, suggest
        from edit3r.reporting import Report, collecting
        from edit3r_measure.bench.report import write_report
        from edit3r_measure.bench.summary import read_columns

        columns = read_columns(map(Path, args.folders))
        labels = [column.label for column in columns]
        if args.first:
            if args.first not in labels:
                raise SettingsError(f"--first {args.first}: no such method.{suggest(args.first, labels)}")
            columns.sort(key=lambda column: column.label != args.first)
        out = Path(args.out) if args.out else Path(args.folders[0]) / "report"
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)):
            table = write_report(columns, out, args.pictures)
        if not args.quiet:
            print(table)
            print(f"{out / 'index.html'}")
        return 0
