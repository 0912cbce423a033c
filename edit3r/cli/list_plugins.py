"""`edit3r list-plugins`: everything on offer, what it lacks, and which plugins failed and why."""

import argparse
import json
from typing import Any

from edit3r.contract.command import Command
from edit3r.contract.component import KINDS
from edit3r.kit.command.console import LONGEST, print_table
from edit3r.kit.command.flags import add_plugin_option
from edit3r.kit.files.text import printable

COLUMNS = ("kind", "name", "plugin", "version", "licence", "summary")


class ListPluginsCommand(Command):
    """List installed plugins and their components, what they lack, and which failed and why."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--kind", choices=KINDS, help="only components of this kind"
        )
        parser.add_argument(
            "--json",
            action="store_true",
            help="machine-readable output; with --check every component's settings too",
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
            if args.check:
                for row, offer in zip(rows, offers):
                    row["settings"] = _settings(registry, offer)
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


def _settings(registry, offer) -> dict | None:
    """By name, what is allowed, the default and a sentence; None where it cannot be imported."""
    from edit3r.contract.errors import Edit3rError
    from edit3r.loading.describe import settings_lines

    try:
        lines = settings_lines(registry.settings_class(offer))
    except Edit3rError:
        return None
    return {
        line.name: {
            "allowed": line.allowed,
            "default": line.default,
            "description": line.sentence,
        }
        for line in lines
    }


def _row(registry, offer, problem: str) -> dict[str, Any]:
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


def _print_table(
    rows: list[dict[str, str]], failures: list[dict[str, str]], remarks: list[str]
) -> None:
    """The table, then one line for everything that is wrong, so that grep finds it whole."""
    marked = [
        {**row, "name": row["name"] + ("*" if row["missing"] else "")} for row in rows
    ]
    print_table(
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
