"""`edit3r mcp`: tools for assistants, over standard input and output."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError


class McpCommand(Command):
    """Serve the Model Context Protocol, until the assistant's program closes the connection."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        about = (
            "all that the tools write goes here; relative names of photos begin here"
        )
        add("--folder", required=True, metavar="DIR", help=about)
        about = "YAML file of settings for every edit, or the name of a shipped one"
        add("--config", metavar="FILE", help=about)
        about = "a call that takes longer is ended (default: %(default)g)"
        add("--limit", type=float, default=1200.0, metavar="SECONDS", help=about)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r_mcp.tools import server

        folder = Path(args.folder).resolve()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"--folder {folder}: cannot be made ({error.strerror})."
            ) from None
        if not args.limit > 0:
            raise InputError(f"--limit {args.limit:g}: expected seconds above 0.")
        server(folder, args.config, args.limit).run("stdio")
        return 0
