"""`edit3r weights`: what can be loaded, under which licence, and fetching it."""

import argparse
import json
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.contract.weights import BUNDLES
from edit3r.kit.command.flags import add_plugin_option

if TYPE_CHECKING:
    from edit3r.contract.weights import Weights


class WeightsCommand(Command):
    """Learned weights that components can load: list them with licences, fetch them, find them."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        steps = parser.add_subparsers(
            dest="step", required=True, metavar="list|get|path"
        )
        about = "all weights that installed components can load"
        listing = steps.add_parser("list", help=about)
        about = "machine-readable output, with whole hashes"
        listing.add_argument("--json", action="store_true", help=about)
        about = "fetch weights after showing their licence; checks every hash, resumes"
        get = steps.add_parser("get", help=about)
        about = "accept the licences without being asked"
        get.add_argument("--yes", action="store_true", help=about)
        about = "only check what is on this machine"
        get.add_argument("--offline", action="store_true", help=about)
        about = "print where weights are stored on this machine"
        path = steps.add_parser("path", help=about)
        about = (
            "as in: edit3r weights list; essentials: all that a CPU needs; words: what finds "
            "things by any word"
        )
        for step in (get, path):
            step.add_argument("names", nargs="+", metavar="NAME", help=about)
        about = "of all weights (default: $EDIT3R_WEIGHTS, else in the user's cache)"
        for step in (listing, get, path):
            step.add_argument("--folder", metavar="DIR", help=about)
            add_plugin_option(step)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.kit.weights.find import find
        from edit3r.loading import declared
        from edit3r_develop.fetch import fetch

        known = declared(tuple(args.plugin))
        if args.step == "list":
            _list(known.values(), args)
            return 0
        names = dict.fromkeys(args.names)
        chosen = [_named(name, known) for name in names if name not in BUNDLES]
        bundled = [one for one in known.values() if one.bundle in names]
        # a machine without the client npm gets all the others first
        chosen += sorted(bundled, key=lambda one: one.source.startswith("npm:"))
        if args.step == "path":
            for weights in chosen:
                print(find(weights, args.folder))
            return 0
        _accept(chosen, args)
        for weights in chosen:
            print(fetch(weights, args.folder, args.offline))
        return 0


def _named(name: str, known: Mapping[str, "Weights"]) -> "Weights":
    """The weights called `name`. Raises InputError where no installed component declares them."""
    from edit3r.contract.errors import InputError, did_you_mean

    if name not in known:
        raise InputError(
            f"no weights named {name!r}.{did_you_mean(name, known)} See: edit3r weights list"
        )
    return known[name]


def _accept(chosen: list["Weights"], args: argparse.Namespace) -> None:
    """Show licences of what is not here and ask once. Raises InputError where they are refused."""
    from edit3r.contract.errors import InputError
    from edit3r.kit.weights.find import at_hand
    from edit3r_develop.fetch import unfinished

    if args.offline:
        return
    missing = [one for one in chosen if at_hand(one, args.folder) is None]
    for weights in missing:
        pinned = weights.revision or "not pinned: the newest is fetched"
        print(
            f"{weights.name}: {weights.purpose}\n  licence: {weights.terms}\n  source: "
            f"{weights.source} ({pinned})"
        )
        if weights.caution:
            print(f"  note: {weights.caution}")
    asked = [one for one in missing if not unfinished(one, args.folder).is_dir()]
    if args.yes or not asked:
        return
    licences = "licence" if len(asked) == 1 else "licences"
    if not sys.stdin.isatty():
        get = f"edit3r weights get {' '.join(args.names)} --yes"
        raise InputError(f"accept the {licences} with: {get}")
    question = f"Accept the {licences} and fetch the files? [y/N] "
    if input(question).strip().lower() not in ("y", "yes"):
        names = ", ".join(weights.name for weights in asked)
        raise InputError(
            f"{names}: the licences were not accepted; nothing was fetched."
            if len(asked) > 1
            else f"{names}: the licence was not accepted; nothing was fetched."
        )


def _list(known, args: argparse.Namespace) -> None:
    from edit3r.contract.errors import InputError
    from edit3r.kit.command.console import print_table
    from edit3r.kit.weights.find import at_hand, folder

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
    lines = [
        {
            "name": weights.name,
            "for": weights.purpose,
            "MB": f"{weights.size / 1e6:,.1f}",
            "licence": weights.licence,
            "commercial": weights.commercial,
            "source": weights.source,
            "revision": weights.revision[:12] or "not pinned",
            "SHA-256": " ".join(one[:12] for _, one in weights.files if one)
            or "the hub's",
            "at hand": "yes" if places[weights.name] else "no",
        }
        for weights in known
    ]
    columns = tuple(lines[0]) if lines else ()
    print_table(columns, [tuple(line.values()) for line in lines])
    try:
        place = f"Folder: {folder(args.folder)}."
    except InputError as error:
        place = str(error)
    print(f"{place} Fetch with: edit3r weights get NAME")
