"""`edit3r plugins`: packages that add to edit3r, and how to install those that are not here."""

import argparse

from edit3r.contract.command import Command
from edit3r.contract.component import KINDS
from edit3r.kit.command.console import print_table

COLUMNS = ("package", "offers", "what it does", "licence", "installed")


class PluginsCommand(Command):
    """List plugins that others published. Nothing is fetched: the list came with edit3r."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--kind", choices=KINDS, help="only those with components of this kind"
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r_develop.directory import listed

        plugins = listed(args.kind)
        if not plugins:
            print(f"No plugin in the directory offers a {args.kind}.")
            return 0
        rows = [
            [one.name, _offers(one), one.does, one.licence, one.installed or "no"]
            for one in plugins
        ]
        print_table(COLUMNS, rows, ("package", "installed"))
        for one in plugins:
            if not one.installed:
                print(f"{one.name}: {one.install}")
        return 0


def _offers(one) -> str:
    return "; ".join(f"{kind} {', '.join(names)}" for kind, names in one.offers.items())
