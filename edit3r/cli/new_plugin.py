"""`edit3r new-plugin`: a plugin package that works at once, to change into one's own."""

import argparse
from pathlib import Path

from edit3r.command import Command
from edit3r.component import KINDS


class NewPluginCommand(Command):
    """`edit3r new-plugin`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("kind", choices=KINDS, help="kind of component")
        parser.add_argument("name", help="name of the component, such as sepia or warm-light")
        parser.add_argument(
            "--path", metavar="DIR", default=".", help="folder to write edit3r-NAME into (default: here)"
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.errors import InputError
        from edit3r.registry import default_registry
        from edit3r.scaffold import new_package, next_steps

        taken = [offer.plugin for offer in default_registry().offers(args.kind) if offer.component.name == args.name]
        if taken:
            raise InputError(
                f"{args.kind} {args.name!r} is already offered by plugin {taken[0]!r}; choose another name."
            )
        folder = new_package(args.kind, args.name, Path(args.path))
        files = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
        print(f"Wrote {folder}:")
        print("\n".join(f"  {file}" for file in files))
        print("Next:")
        print("\n".join(f"  {step}" for step in next_steps(args.kind, args.name, folder)))
        return 0
