"""`edit3r weights`: what can be loaded, under which licence, and fetching it."""

import argparse
import json
import sys
from typing import TYPE_CHECKING

from edit3r.contract.command import Command, add_plugin_option

if TYPE_CHECKING:
    from edit3r.contract.weights import Weights


class WeightsCommand(Command):
    """`edit3r weights`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        steps = parser.add_subparsers(
            dest="step", required=True, metavar="list|get|path"
        )
        listing = steps.add_parser(
            "list", help="all weights that installed components can load"
        )
        listing.add_argument(
            "--json",
            action="store_true",
            help="machine-readable output, with whole hashes",
        )
        get = steps.add_parser(
            "get",
            help="fetch weights after showing their licence; checks every hash, resumes",
        )
        get.add_argument(
            "--yes", action="store_true", help="accept the licences without being asked"
        )
        get.add_argument(
            "--offline", action="store_true", help="only check what is on this machine"
        )
        path = steps.add_parser("path", help="print where weights lie on this machine")
        for step in (get, path):
            step.add_argument(
                "names", nargs="+", metavar="NAME", help="as in: edit3r weights list"
            )
        for step in (listing, get, path):
            step.add_argument(
                "--folder",
                metavar="DIR",
                help="of all weights (default: $EDIT3R_WEIGHTS, else in the user's cache)",
            )
            add_plugin_option(step)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.plugins.weights import declared, find, named

        known = declared(tuple(args.plugin))
        if args.step == "list":
            _list(known.values(), args)
            return 0
        for weights in [named(name, known) for name in args.names]:
            print(
                _get(weights, args)
                if args.step == "get"
                else find(weights, args.folder)
            )
        return 0


def _get(weights: "Weights", args: argparse.Namespace) -> str:
    """Fetch weights once the user accepts their licence; raises InputError otherwise."""
    from edit3r.errors import InputError
    from edit3r.io.fetching import fetch, unfinished
    from edit3r.plugins.weights import at_hand

    if at_hand(weights, args.folder) is None and not args.offline:
        pinned = weights.revision or "not pinned: the newest is fetched"
        print(
            f"{weights.name}: {weights.purpose}\n  licence: {weights.terms}\n  source: "
            f"{weights.source} ({pinned})"
        )
        if not (args.yes or unfinished(weights, args.folder).is_dir()):
            if not sys.stdin.isatty():
                raise InputError(f"accept the licence with: {weights.get} --yes")
            if input(
                "Accept this licence and fetch the files? [y/N] "
            ).strip().lower() not in ("y", "yes"):
                raise InputError(
                    f"{weights.name}: the licence was not accepted; nothing was fetched."
                )
    return str(fetch(weights, args.folder, args.offline))


def _list(known, args: argparse.Namespace) -> None:
    from edit3r.cli.list_plugins import table
    from edit3r.plugins.weights import at_hand, folder

    places = {weights.name: at_hand(weights, args.folder) for weights in known}
    if args.json:
        rows = [
            {
                **vars(weights),
                "files": dict(weights.files),
                "path": str(places[weights.name] or ""),
            }
            for weights in known
        ]
        print(json.dumps(rows, indent=2))
        return
    columns = (
        "name",
        "for",
        "MB",
        "licence",
        "commercial",
        "source",
        "revision",
        "SHA-256",
        "at hand",
    )
    lines = [
        (
            weights.name,
            weights.purpose,
            f"{weights.size / 1e6:,.1f}",
            weights.licence,
            weights.commercial,
            weights.source,
            weights.revision[:12] or "not pinned",
            " ".join(sha256[:12] for _, sha256 in weights.files if sha256)
            or "the hub's",
            "yes" if places[weights.name] else "no",
        )
        for weights in known
    ]
    table(columns, lines)
    print(f"Folder: {folder(args.folder)}. Fetch with: edit3r weights get NAME")
