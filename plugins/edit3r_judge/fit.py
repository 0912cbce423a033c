"""`edit3r judge --fit ROWS`: the limits of the signals, from what is known to be good and bad.

A row of ROWS (JSON lines) is an edit (`python benchmarks/verdict.py edits`): its `place`, its
`fault` (the signal that names it; null: none), its `kind` and its `figures`; or a scene
(`python benchmarks/verdict.py scenes`): its `place`, the `label` that views which no run saw
deserve, and its `figures`.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError
from edit3r.contract.verdicts import LABELS

NEVER = 3  # each third place of edits is fitted on by nobody
# hardly any scene fails, so what parts poor and failed is not fitted
FITTED_LABELS = LABELS[:2]
NEEDED = {"edit": {"place", "fault", "kind", "figures"}}
NEEDED["scene"] = {"place", "label", "figures"}
Row = Mapping[str, Any]
Limits = Mapping[str, Any]


class JudgeCommand(Command):
    """`edit3r judge`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "--fit",
            required=True,
            metavar="ROWS",
            help="edits, or scenes, of which it is known whether they are good, one JSON object a "
            "line",
        )
        add("--write", action="store_true", help="write the limits into the package")

    def main(self, args: argparse.Namespace) -> int:
        what, rows = read_rows(args.fit)
        places = sorted({row["place"] for row in rows})
        never = places[::NEVER] if what == "edit" else []
        known = [row for row in rows if row["place"] not in never]
        fit, report = WAYS[what]
        print(f"{len(known)} {what}s, each by limits without its place")
        print(report(left_out(known, fit)))
        limits = fit(known)
        if never:
            print(f"never fitted on: {', '.join(never)}")
            print(report([(row, limits) for row in rows if row["place"] in never]))
        else:
            print("by limits fitted to all")
            print(report([(row, limits) for row in rows]))
        print(json.dumps(limits, indent=1))
        if args.write:
            write_limits({what: limits})
        return 0


def left_out(
    rows: Sequence[Row], fit: Callable[[Sequence[Row]], Limits]
) -> list[tuple[Row, Limits]]:
    """Each row with limits that were fitted without its place."""
    return [
        (row, limits)
        for place in sorted({row["place"] for row in rows})
        for limits in [fit([row for row in rows if row["place"] != place])]
        for row in rows
        if row["place"] == place
    ]


def read_rows(path: str) -> tuple[str, list[Row]]:
    """The "edit"s or "scene"s of a file. Raises InputError for what is neither."""
    try:
        rows = [json.loads(line) for line in Path(path).read_text().splitlines()]
        for what, needed in NEEDED.items():
            if all(needed <= {*row} for row in rows):
                return what, rows
        raise ValueError("a row lacks place, figures, or fault and kind, or label")
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: {error}; expected rows of benchmarks/verdict.py."
        ) from None


def write_limits(limits: Mapping[str, Limits]) -> None:
    """Put limits into the package; comments and all that is not in `limits` stay."""
    from edit3r_judge.signals import FITTED

    lines = FITTED.read_text().splitlines(keepends=True)
    path: list[str] = []
    for number, line in enumerate(lines):
        name, _, value = line.strip().partition(":")
        if line.startswith("#") or not name:
            continue
        path = [*path[: (len(line) - len(line.lstrip())) // 2], name]
        found: Any = limits
        for key in path:
            found = found.get(key, {}) if isinstance(found, Mapping) else {}
        if value and not isinstance(found, Mapping):
            lines[number] = line.replace(value, f" {found:.3g}")
    FITTED.write_text("".join(lines))


def limits_of_edits(rows: Sequence[Row]) -> Limits:
    """For each signal the limit between edits without a fault and those with its own; a good edit
    beyond it counts twice.
    """
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
        limits[name] = sign * between(good, bad, 2 / len(good), 1 / len(bad))
    return limits


def limits_of_scenes(rows: Sequence[Row]) -> Limits:
    """By label, for each signal the limit with which fewest scenes are wrong, the other's given."""
    limits: dict[str, dict[str, float]] = {}
    for label in FITTED_LABELS:
        limits[label] = {"agreement": -math.inf, "guessed": math.inf}
        for name, sign in 2 * (("agreement", -1), ("guessed", 1)):
            open_ones = {label: limits[label] | {name: sign * math.inf}}
            both: tuple[list[float], list[float]] = [], []
            for row in rows:
                if reaches(row["figures"], open_ones[label]):
                    worse = LABELS.index(row["label"]) > LABELS.index(label)
                    both[worse].append(sign * row["figures"][name])
            if all(both):
                limits[label][name] = sign * between(*both, 1, 1)
    return limits


def reaches(figures: Mapping[str, float], limits: Mapping[str, float]) -> bool:
    """Whether a scene has what a label needs of the fitted signals."""
    agrees = figures["agreement"] >= limits["agreement"]
    return agrees and figures["guessed"] <= limits["guessed"]


def between(
    good: Sequence[float], bad: Sequence[float], over: float, under: float
) -> float:
    """The limit above which fewest `good` values and below which fewest `bad` ones lie, where a
    good one counts `over` and a bad one `under`; of equal limits the middle of the widest gap.
    """
    values = sorted({*good, *bad})
    limits = [(low + high) / 2 for low, high in pairwise(values)]
    gaps = [high - low for low, high in pairwise(values)]

    def wrong(limit: float) -> float:
        beyond = over * sum(value > limit for value in good)
        return round(beyond + under * sum(value <= limit for value in bad), 9)

    errors = [wrong(limit) for limit in limits]
    return max(zip(errors, gaps, limits), key=lambda one: (-one[0], one[1]))[2]


def report_of_scenes(judged: Sequence[tuple[Row, Limits]]) -> str:
    """How often `good` and `fair` scenes hold and the others do not, and how often `good` is."""
    lines = []
    for label, word in zip(FITTED_LABELS, ("good", "good or fair")):
        kind = hard = 0
        for row, limits in judged:
            called = reaches(row["figures"], limits[label])
            holds = LABELS.index(row["label"]) <= LABELS.index(label)
            kind, hard = kind + (called > holds), hard + (called < holds)
        right = 1 - (kind + hard) / max(1, len(judged))
        lines.append(f"{word}: right {right:.1%}, too kind {kind}, too hard {hard}")
    return "\n".join(lines)


def report_of_edits(judged: Iterable[tuple[Row, Mapping[str, float]]]) -> str:
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


WAYS: Mapping[str, tuple[Callable, Callable]] = {
    "edit": (limits_of_edits, report_of_edits),
    "scene": (limits_of_scenes, report_of_scenes),
}
"""How limits are fitted, and what is said of them."""
