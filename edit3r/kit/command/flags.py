"""Flags that several commands have."""

import argparse
from typing import Any

OVERWRITE = "replace an earlier result in --out even where it was changed"
REPEATED: dict[str, Any] = {"action": "append", "default": []}


def add_common(
    parser: argparse.ArgumentParser, settings: str = "", overwrite: str = ""
) -> None:
    """Declare `--plugin` and `--quiet`; with help for them `--set` and `--overwrite` too."""
    if settings:
        parser.add_argument("--set", metavar="KEY=VALUE", help=settings, **REPEATED)
    add_plugin_option(parser)
    add_output_flags(parser, overwrite)


def add_output_flags(parser: argparse.ArgumentParser, overwrite: str = "") -> None:
    """Declare `--quiet`, and with help for it `--overwrite`."""
    if overwrite:
        parser.add_argument("--overwrite", action="store_true", help=overwrite)
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def add_plugin_option(parser: argparse.ArgumentParser) -> None:
    """Add `--plugin PATH`, whose values a registry takes as local files."""
    about = "also load this plugin, which need not be installed: a file, or a package's folder"
    parser.add_argument("--plugin", metavar="PATH", help=about, **REPEATED)


def add_trust_flag(parser: argparse.ArgumentParser) -> None:
    """Add the consent to programs and addresses that a file of settings names."""
    parser.add_argument(
        "--trust-config",
        action="store_true",
        help="let files of settings name programs to run and addresses to send data to",
    )
