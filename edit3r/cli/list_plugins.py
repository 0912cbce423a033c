"""`edit3r list-plugins`: everything on offer, what it lacks, and which plugins failed and why."""

import argparse
import json
import sys
from collections.abc import Sequence

from edit3r.contract.command import Command
from edit3r.contract.component import KINDS
from edit3r.kit.command.flags import add_plugin_option
from edit3r.kit.files.text import printable

LONGEST = 400  # characters of a cell: texts of plugins are strangers'
COLUMNS = ("kind", "name", "plugin", "version", "licence", "summary")
PIPED_WIDTH = 400  # piped output is not wrapped, so that grep finds what it looks for


class ListPluginsCommand(Command):
    """`edit3r list-plugins`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--kind", choices=KINDS, help="only components of this kind"
        )
        parser.add_argument(
            "--json", action="store_true", help="machine-readable output"
        )
        parser.add_argument(
            "--check",
            action="store_true",
            help="also import every component and check its interface",
        )
        parser.add_argument(
            "--strict",
            action="store_true",
            help="exit with 1 when a plugin failed or a name clashes",
        )
        add_plugin_option(parser)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.loading.check import check_offer
        from edit3r.loading.load import load_plugins
        from edit3r.loading.registry import Registry

        registry = Registry(load_plugins(args.plugin))  # failures are listed
        offers = registry.offers(args.kind)
        problems = {
            offer: check_offer(registry, offer) if args.check else ""
            for offer in offers
        }
        rows = [_row(registry, offer, problems[offer]) for offer in offers]
        failures = [vars(failure) for failure in registry.failures]
        clashes = registry.clashes()
        if args.json:
            print(
                json.dumps(
                    {"components": rows, "failures": failures, "clashes": clashes},
                    indent=2,
                )
            )
        else:
            _print_table(rows, failures, clashes)
        broken = failures or clashes or any(problems.values())
        return 1 if args.strict and broken else 0


def _row(registry, offer, problem: str) -> dict[str, str]:
    from edit3r.kit.weights.find import at_hand
    from edit3r.loading.registry import install_hint

    missing = registry.missing(offer)
    return {
        "plugin": offer.plugin,
        "version": offer.version,
        "kind": offer.kind,
        "name": offer.component.name,
        "summary": offer.component.summary,
        "licence": offer.component.licence,
        "keeps": offer.component.keeps,
        "loses": offer.component.loses,
        "missing": f"{', '.join(missing)}; {install_hint(offer)}" if missing else "",
        "weights": [
            f"{w.get} ({w.terms})"
            for w in offer.component.weights
            if at_hand(w) is None
        ],
        "problem": problem,
    }


def table(
    columns: Sequence[str], rows: Sequence[Sequence[str]], whole: Sequence[str] = ()
) -> None:
    """Print a table; columns in `whole` are not wrapped, and nothing is where the output is
    piped.
    """
    from rich.console import Console
    from rich.table import Table

    console = Console(
        highlight=False, width=None if sys.stdout.isatty() else PIPED_WIDTH
    )
    shown = Table(box=None, header_style="bold", pad_edge=False)
    for column in columns:
        shown.add_column(column, overflow="fold", no_wrap=column in whole)
    for row in rows:
        shown.add_row(*(printable(cell)[:LONGEST] for cell in row))
    console.print(shown, markup=False)


def _print_table(
    rows: list[dict[str, str]], failures: list[dict[str, str]], remarks: list[str]
) -> None:
    """The table, then one line for everything that is wrong, so that grep finds it whole."""
    marked = [
        {**row, "name": row["name"] + ("*" if row["missing"] else "")} for row in rows
    ]
    table(
        COLUMNS,
        [[row[column] for column in COLUMNS] for row in marked],
        ("kind", "name", "plugin", "version"),
    )
    lines = [
        f"* {row['kind']} {row['name']} needs {row['missing']}"
        for row in rows
        if row["missing"]
    ]
    lines += [
        f"weights: {row['kind']} {row['name']} can load: {get}"
        for row in rows
        for get in row["weights"]
    ]
    lines += [
        f"writer {row['name']} keeps {row['keeps']}; loses {row['loses']}"
        for row in rows
        if row["keeps"]
    ]
    lines += [f"problem: {row['problem']}" for row in rows if row["problem"]]
    for failure in failures:
        version = f" {failure['version']}" if failure["version"] else ""
        lines.append(
            f"failed: plugin {failure['plugin']}{version}: {failure['reason']}"
        )
    lines += [f"note: {remark}" for remark in remarks]
    print("\n".join(printable(line)[: 10 * LONGEST] for line in lines))
