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

import yaml

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError
from edit3r.contract.verdicts import LABELS
from edit3r.kit.files.configs import read_yaml

NEVER = 3  # each third place of edits is fitted on by nobody
# hardly any scene fails, so what parts poor and failed is not fitted
FITTED_LABELS = LABELS[:2]
NEEDED = {"edit": {"place", "fault", "kind", "figures"}}
NEEDED["scene"] = {"place", "label", "figures"}
Row = Mapping[str, Any]
Limits = Mapping[str, Any]
Judged = Iterable[tuple[Row, Limits]]


class JudgeCommand(Command):
    """Fit the limits of the verdict to edits of which it is known whether they are good."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        known = "edits, or scenes, of which it is known whether they are good, one JSON object each"
        parser.add_argument("--fit", required=True, metavar="ROWS", help=known)
        text = "write the limits into the package"
        parser.add_argument("--write", action="store_true", help=text)

    def main(self, args: argparse.Namespace) -> int:
        what, rows = read_rows(args.fit)
        places = sorted({row["place"] for row in rows})
        never = places[::NEVER] if what == "edit" else []
        known = [row for row in rows if row["place"] not in never]
        fit, report = WAYS[what]
        limits = fit(known)
        print(f"{len(known)} {what}s, each by limits without its place")
        print(report(left_out(known, fit)))
        print(f"never fitted on: {', '.join(never)}" if never else "fitted to all")
        rest = [row for row in rows if row["place"] in never] or rows
        print(report([(row, limits) for row in rest]))
        print(json.dumps(limits, indent=1))
        if args.write:
            write_limits({what: limits})
        return 0


def left_out(
    rows: Sequence[Row], fit: Callable[[Sequence[Row]], Limits]
) -> list[tuple[Row, Limits]]:
    """Each row with limits that were fitted without its place."""
    places = sorted({row["place"] for row in rows})
    limits = {
        place: fit([row for row in rows if row["place"] != place]) for place in places
    }
    return [(row, limits[row["place"]]) for row in rows]


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
    """Put limits into the package; what is not in `limits` stays, and the comment on top."""

    from edit3r_judge.signals import FITTED

    def merged(old: Any, new: Any) -> Any:
        if isinstance(new, Mapping):
            return old | {key: merged(old.get(key, {}), new[key]) for key in new}
        return float(f"{new:.3g}")

    text = FITTED.read_text()
    comment = [line for line in text.splitlines(True) if line.startswith("#")]
    kept = yaml.safe_dump(merged(read_yaml(FITTED), limits), sort_keys=False)
    FITTED.write_text("".join(comment) + kept)


def limits_of_edits(rows: Sequence[Row]) -> Limits:
    """For each signal the limit between edits without a fault and those with its own; a good edit
    beyond it counts twice.
    """
    from edit3r_judge.signals import SIGNALS

    limits = {}
    for name, signal in SIGNALS.items():
        sign = -1 if signal.at_least else 1
        told = [row for row in rows if row["figures"][name] is not None]
        good, bad = (
            [sign * row["figures"][name] for row in told if row["fault"] == fault]
            for fault in (None, name)
        )
        limits[name] = sign * between(good, bad, 2 / len(good), 1 / len(bad))
    return limits


def limits_of_scenes(rows: Sequence[Row]) -> Limits:
    """By label, for each signal the limit with which fewest scenes are wrong, the other's given."""
    limits: dict[str, dict[str, float]] = {}
    for number, label in enumerate(FITTED_LABELS):
        limits[label] = {"agreement": -math.inf, "guessed": math.inf}
        for name, sign in 2 * (("agreement", -1), ("guessed", 1)):
            limits[label][name] = sign * math.inf
            both: tuple[list[float], list[float]] = [], []
            for row in rows:
                if reaches(row["figures"], limits[label]):
                    worse = LABELS.index(row["label"]) > number
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

    def rank(pair: tuple[float, float]) -> tuple[float, float]:
        beyond = over * sum(value >= pair[1] for value in good)
        wrong = beyond + under * sum(value <= pair[0] for value in bad)
        return -round(wrong, 9), pair[1] - pair[0]

    low, high = max(pairwise(sorted({*good, *bad})), key=rank)
    return (low + high) / 2


def report_of_scenes(judged: Judged) -> str:
    """How often `good` and `fair` scenes hold and the others do not, and how often `good` is."""
    lines = []
    for number, (label, word) in enumerate(
        zip(FITTED_LABELS, ("good", "good or fair"))
    ):
        over = [
            reaches(row["figures"], limits[label])
            - (LABELS.index(row["label"]) <= number)
            for row, limits in judged
        ]
        kind, hard = over.count(1), over.count(-1)
        right = over.count(0) / max(1, len(over))
        lines.append(f"{word}: right {right:.1%}, too kind {kind}, too hard {hard}")
    return "\n".join(lines)


def report_of_edits(judged: Judged) -> str:
    """How often the verdict is right, and how often each kind of fault is named as that."""
    from edit3r_judge.signals import faults_of

    named = [(row, faults_of(row["figures"], limits)) for row, limits in judged]
    called = [row["fault"] is None for row, faults in named if not faults]
    doubted = [bool(faults) for row, faults in named if row["fault"] is None]
    right = sum(called) / max(1, len(called))
    lines = [
        f"called good {len(called)}, are {sum(called)} ({right:.1%})",
        f"good ones doubted {sum(doubted)} of {len(doubted)}",
    ]
    for kind, fault in dict.fromkeys((row["kind"], row["fault"]) for row, _ in named):
        own = [
            said for row, said in named if (row["kind"], row["fault"]) == (kind, fault)
        ]
        count = sum(fault in said if fault else not said for said in own)
        lines.append(f"  {kind:18} called {fault or 'good':15} {count} of {len(own)}")
    return "\n".join(lines)


WAYS: Mapping[str, tuple[Callable, Callable]] = {
    "edit": (limits_of_edits, report_of_edits),
    "scene": (limits_of_scenes, report_of_scenes),
}
"""How limits are fitted, and what is said of them."""
