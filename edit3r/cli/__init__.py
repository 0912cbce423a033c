"""The command line: one file a command, each a `Command` like those that plugins bring.

Nothing is imported here: Ctrl-C is handled only once `program` is there.
"""
