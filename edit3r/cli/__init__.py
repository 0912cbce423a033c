"""The command line: one file a command.

A command is a module here whose name has no underscore in front (and is not `main`): `list_plugins.py` is
`edit3r list-plugins`. It has `HELP` (one sentence), `add_arguments(parser)` and `main(args) -> int`, and imports
nothing heavy at its top, so that `--help` stays quick.
"""
