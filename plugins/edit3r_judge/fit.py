"""`edit3r judge --fit ROWS`: the limits of the signals, from edits that were made well and badly.

A row of ROWS (JSON lines, `python benchmarks/edit_verdict.py`) is one edit: its `place`, its
`fault` (the signal that names it; null: none), its `kind` and its `figures`.
"""

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError

NEVER = 3  # each third place is fitted on by nobody
Row = Mapping[str, Any]


class JudgeCommand(Command):
    """`edit3r judge`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "--fit",
            required=True,
            metavar="ROWS",
            help="edits of which it is known whether they are good, one JSON object a line",
        )
        add("--write", action="store_true", help="write the limits into the package")

    def main(self, args: argparse.Namespace) -> int:
        rows = read_rows(args.fit)
        places = sorted({row["place"] for row in rows})
        never = places[::NEVER]
        known = [row for row in rows if row["place"] not in never]
        left_out = [
            (row, limits)
            for place in sorted({row["place"] for row in known})
            for limits in [limits_of([row for row in known if row["place"] != place])]
            for row in known
            if row["place"] == place
        ]
        limits = limits_of(known)
        print(f"{len(known)} edits, each by limits without its place")
        print(report(left_out))
        print(f"never fitted on: {', '.join(never)}")
        print(report([(row, limits) for row in rows if row["place"] in never]))
        for name, limit in limits.items():
            print(f"{name}: {limit:.3g}")
        if args.write:
            write_limits(limits)
        return 0


def read_rows(path: str) -> list[Row]:
    """The edits of a file. Raises InputError for what is none."""
    try:
        rows = [json.loads(line) for line in Path(path).read_text().splitlines()]
        if not all({"place", "fault", "kind", "figures"} <= {*row} for row in rows):
            raise ValueError("a row lacks place, fault, kind or figures")
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: {error}; expected rows of benchmarks/edit_verdict.py."
        ) from None
    return rows


def write_limits(limits: Mapping[str, float]) -> None:
    """Put the edit's limits into the package; comments and the scene's stay."""
    from edit3r_judge.signals import FITTED

    lines = FITTED.read_text().splitlines(keepends=True)
    for number, line in enumerate(lines):
        name = line.split(":")[0].strip()
        if name in limits:
            lines[number] = f"  {name}: {limits[name]:.3g}\n"
    FITTED.write_text("".join(lines))


def limits_of(rows: Sequence[Row]) -> dict[str, float]:
    """For each signal the limit between edits without a fault and those with its own."""
    from edit3r_judge.signals import SIGNALS

    limits = {}
    for name, signal in SIGNALS.items():
        sign = -1 if signal.at_least else 1
        good, bad = (
            [
                sign * row["figures"][name]
                for row in rows
                if row["fault"] == fault and row["figures"][name] is not None
            ]
            for fault in (None, name)
        )
        limits[name] = sign * between(good, bad)
    return limits


def between(good: Sequence[float], bad: Sequence[float]) -> float:
    """The limit above which fewest `good` values and below which fewest `bad` ones lie, as shares;
    a good one counts twice, and of equal limits the middle of the widest gap is taken.
    """
    values = sorted({*good, *bad})
    limits = [(low + high) / 2 for low, high in pairwise(values)]
    gaps = [high - low for low, high in pairwise(values)]

    def wrong(limit: float) -> float:
        over = sum(value > limit for value in good) / len(good)
        return 2 * over + sum(value <= limit for value in bad) / len(bad)

    errors = [wrong(limit) for limit in limits]
    return max(zip(errors, gaps, limits), key=lambda one: (-one[0], one[1]))[2]


def report(judged: Iterable[tuple[Row, Mapping[str, float]]]) -> str:
    """How often the verdict is right, and how often each kind of fault is named as that."""
    from edit3r_judge.critic import faults_of

    named = [(row, faults_of(row["figures"], limits)) for row, limits in judged]
    called = [row for row, faults in named if not faults]
    good = [faults for row, faults in named if row["fault"] is None]
    right = sum(row["fault"] is None for row in called)
    lines = [
        f"called good {len(called)}, are {right} ({right / max(1, len(called)):.1%})",
        f"good ones doubted {sum(map(bool, good))} of {len(good)}",
    ]
    for kind in dict.fromkeys(row["kind"] for row, _ in named):
        own = [(row["fault"], faults) for row, faults in named if row["kind"] == kind]
        fault = own[0][0]
        if fault is None:
            count, said = sum(not faults for _, faults in own), "good"
        else:
            count, said = sum(fault in faults for _, faults in own), fault
        lines.append(f"  {kind:18} called {said:15} {count} of {len(own)}")
    return "\n".join(lines)
