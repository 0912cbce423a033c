"""`python -m edit3r` is the command `edit3r`."""

import sys

from edit3r.cli.main import program

sys.exit(program())
