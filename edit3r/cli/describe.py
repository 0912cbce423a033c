"""`edit3r describe`: a component's settings, what to know before using it, and YAML to paste."""

import argparse
import json

from edit3r.contract.command import Command
from edit3r.contract.component import KINDS
from edit3r.kit.command.flags import add_plugin_option
from edit3r.kit.files.text import printable


class DescribeCommand(Command):
    """Show a component's settings, licence and needs, and YAML to paste into a configuration."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("kind", choices=KINDS, help="kind of component")
        parser.add_argument(
            "name", help="name as in edit3r list-plugins, or plugin:name"
        )
        parser.add_argument(
            "--json",
            action="store_true",
            help="what is known of it, the JSON schema of its settings, and an example",
        )
        add_plugin_option(parser)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.contract.errors import MissingDependencyError
        from edit3r.loading.describe import described, metadata_lines
        from edit3r.loading.registry import default_registry

        registry = default_registry(tuple(args.plugin))
        offer = registry.find(args.kind, args.name)
        if args.json:
            print(json.dumps(described(registry, offer), indent=2))
            return 0
        try:
            use = _use(offer, registry.settings_class(offer))
        except MissingDependencyError as missing:
            use = f"Settings are not known: {missing}"
        about = _table(metadata_lines(offer.component))
        text = f"{_title(offer)}\n\n{about}\n\n{use}"
        print("\n".join(map(printable, text.split("\n"))))
        return 0


def _use(offer, settings) -> str:
    """Settings and how to give them; a command has arguments instead."""
    from edit3r.loading.describe import settings_lines, yaml_example

    if offer.kind == "command":
        return f"Its arguments: edit3r {offer.component.name} --help"
    lines = settings_lines(settings)
    if offer.kind == "writer":
        name = offer.component.name
        return (
            f"Settings:\n{_settings(lines)}\n\n"
            f"In a run: edit3r run --outputs scene,images,{name} (or --export {name})\n"
            f"Of a saved one: edit3r export RUN --to {name}"
        )
    return (
        f"Settings:\n{_settings(lines)}\n\n"
        "YAML to paste into a configuration (edit3r run --config "
        f"FILE):\n\n{yaml_example(offer, settings)}\n\n"
        f"One setting on the command line: {_flag(offer, lines)}"
    )


def _title(offer) -> str:
    version = f" {offer.version}" if offer.version else " (not installed)"
    component = offer.component
    source = f"from plugin {offer.plugin}{version}"
    return f"{offer.kind} {component.name}, {source}\n{component.summary}"


def _table(rows) -> str:
    width = max(len(what) for what, _ in rows)
    return "\n".join(f"  {what:<{width}}  {value}" for what, value in rows)


def _settings(lines) -> str:
    if not lines:
        return "  none"
    rows = []
    for line in lines:
        value = "?" if line.required else line.default_yaml
        rows.append(
            f"  {line.name} = {value}\n      {line.allowed}\n      "
            f"{line.sentence or 'no description'}"
        )
    return "\n".join(rows)


def _flag(offer, lines) -> str:
    from edit3r.loading.describe import PART_KINDS

    if not lines:
        return "there is none to set"
    name, value = lines[0].name, lines[0].default_yaml
    if offer.kind == "refiner":
        return f"--set 'refiners=[{{name: {offer.component.name}, {name}: {value}}}]'"
    owner = "reconstructor." if offer.kind in PART_KINDS else ""
    return f"--set {owner}{offer.kind}.{name}={value}"
