"""`edit3r schema`: the JSON schema of a command's configuration file."""

import argparse
import json

from edit3r.contract.command import Command
from edit3r.kit.command.flags import add_plugin_option


class SchemaCommand(Command):
    """Print the JSON schema of a command's configuration file (run, train, bench), for an editor.

    With `edit3r schema run > run.schema.json`, the first line of a YAML file is
    `# yaml-language-server: $schema=run.schema.json`.
    """

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("name", help="the command, such as run or train")
        add_plugin_option(parser)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.cli.main import UsageError, find_command
        from edit3r.loading.registry import default_registry
        from edit3r.loading.schema import configuration_schema
        from edit3r.running.config import RunConfig

        registry = default_registry(tuple(args.plugin))
        cls = find_command(args.name).configuration()
        if cls is None:
            raise UsageError(f"edit3r {args.name} reads no configuration file.")
        title = f"Configuration of edit3r {args.name}"
        schema = configuration_schema(registry, cls, title, {"run": RunConfig})
        print(json.dumps(schema, indent=2))
        return 0
