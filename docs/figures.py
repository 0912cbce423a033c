"""The tables of figures in the documents, remade by the commands that measure them.

    python docs/figures.py --data DIR            all that take less than five minutes
    python docs/figures.py --data DIR NAME...    these
    python docs/figures.py --check               which are of older code, or changed by hand

DIR holds the photo sets of the benchmarks, one folder a set; `photos/` stands for it in a command.
A table stands on its page between two comments; under it are written the commit of the code that
was measured and the command. What a command printed is kept in runs/figures, by commit, so that a
table is measured once. Uncommitted changes of the code are refused.
"""

import argparse
import hashlib
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "runs/figures"
QUICK = 5  # minutes


@dataclass(frozen=True)
class Table:
    """Where a table stands and what prints it."""

    page: str
    command: str
    minutes: float


TABLES = {
    "formats": Table("docs/files.md", "python benchmarks/files.py formats", 1),
    "poses": Table(
        "docs/classical.md",
        "python benchmarks/poses.py pairs photos/bear photos/fern photos/fox photos/monstree "
        "--size 512 --matches sift",
        4,
    ),
    "held-out": Table(
        "docs/notes/scenes.md", "python benchmarks/scenes.py held-out photos/", 1
    ),
}


def parts(text: str, name: str) -> re.Match[str]:
    """The table `name` in the text of its page: start, table, commit, digest of the table."""
    found = re.search(
        r"(?s)(<!-- figures: [^\n]* -->\n)((?:(?!<!-- ).)*?)"
        rf"(?:\n\nMeasured at `(\w+)` by `[^\n]*`\.\n)?<!-- end of figures {name} (\w+) -->",
        text,
    )
    if not found:
        raise ValueError(f"no table between the comments of the figures {name}")
    return found


def replaced(text: str, name: str, table: str, commit: str) -> str:
    """The page with a new table `name`."""
    command = TABLES[name].command
    found = parts(text, name)
    return (
        f"{text[: found.start()]}<!-- figures: {command} -->\n{table}\n\n"
        f"Measured at `{commit}` by `{command}`.\n"
        f"<!-- end of figures {name} {digest(table)} -->{text[found.end() :]}"
    )


def digest(table: str) -> str:
    return hashlib.sha256(table.encode()).hexdigest()[:8]


def complaint(text: str, name: str, commit: str) -> str:
    """What is wrong with the table `name`; empty where it is as `commit` made it."""
    _, table, made_at, kept = parts(text, name).groups()
    if digest(table) != kept:
        return "was changed by hand"
    return "" if made_at == commit else f"is of {made_at}, the code is at {commit}"


def present_commit(table: Table) -> str:
    """The last commit that touched the code that the table measures."""
    code = ["--", "edit3r", "plugins", table.command.split()[1]]
    if git("diff", "HEAD", "--name-only", *code):
        return "changed"
    return git("log", "-1", "--format=%h", "--abbrev=9", *code)


def git(*arguments: str) -> str:
    return subprocess.check_output(["git", *arguments], cwd=ROOT, text=True).strip()


def measured(name: str, commit: str, data: str) -> str:
    """What the command of the table prints, now or earlier at the same commit."""
    kept = KEPT / commit / f"{name}.md"
    if not kept.is_file():
        _, *arguments = shlex.split(TABLES[name].command.replace("photos/", f"{data}/"))
        printed = subprocess.run(
            [sys.executable, *arguments], cwd=ROOT, stdout=subprocess.PIPE, check=True
        ).stdout
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(printed)
    return kept.read_text(encoding="utf-8").strip()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(TABLES))
    parser.add_argument("--data", help="folder of photo sets")
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    asked = args.names or TABLES
    wrong = 0
    for name, table in TABLES.items():
        if name not in asked or not (args.check or args.names or table.minutes < QUICK):
            continue
        page = ROOT / table.page
        text = page.read_text(encoding="utf-8")
        commit = present_commit(table)
        if not args.check:
            if commit == "changed":
                raise SystemExit("commit your changes first: a table names its commit")
            made = measured(name, commit, args.data)
            page.write_text(replaced(text, name, made, commit), encoding="utf-8")
        elif sentence := complaint(text, name, commit):
            wrong += 1
            print(f"{table.page}: the table {name} {sentence}")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())
