"""The limits of the verdict's signals, from what is known to be good and bad.

    python benchmarks/fit_verdict.py ROWS.jsonl [--write]

A row is an edit (`verdict.py edits`): its `place`, its `fault` (the signal that names it; null:
none), its `kind` and its `figures`; a scene (`verdict.py scenes`): its `place`, the `label` that
views which no run saw deserve, and its `figures`; or what a reconstructor made that is broken on
purpose (`broken.py`): its `place`, `kind`, `strength` from 1 to 3 (0: it is sound), and its
`figures`. --write puts the limits into the package.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from pathlib import Path
from statistics import quantiles
from typing import Any

import yaml
from edit3r_judge import signals
from edit3r_judge.signals import SIGNALS, faults_of, fitted_limits
from harness import run_benchmark

from edit3r.contract.errors import InputError
from edit3r.contract.verdicts import LABELS
from edit3r.kit.files.configs import read_yaml

NEVER = 3  # each third place is fitted on by nobody
# hardly any scene fails, so what parts poor and failed is not fitted
FITTED_LABELS = LABELS[:2]
MUST = 2  # strength from which a broken reconstructor must be told
BLURRED = ("torn", "fat")  # kinds whose depths are right
NO_DEPTH = ("plane", "exchanged", "turned", "aside")  # as one flat picture, or worse
Row = Mapping[str, Any]
Limits = Mapping[str, Any]
Outcomes = Iterator[tuple[str, bool]]


def main(rows: Path, *, write: bool = False) -> Iterator[dict[str, str]]:
    """How often each outcome is right: each place by limits without it, and places that nobody
    fitted on.
    """
    what, found = read_rows(rows)
    fit, outcomes = WAYS[what]
    places = sorted({row["place"] for row in found})
    never = places[::NEVER]
    known = [row for row in found if row["place"] not in never]
    limits, without = fit(known), {}
    for place in {*places} - {*never}:
        without[place] = fit([row for row in known if row["place"] != place])
    fitted = counted(outcomes(row, without[row["place"]]) for row in known)
    rest = counted(outcomes(row, limits) for row in found if row["place"] in never)
    title = f"never fitted on: {', '.join(never)}"
    for name in sorted({*fitted, *rest}, key=lambda one: one.startswith(" ")):
        shown = {"without its place": fitted.get(name, "-"), title: rest.get(name, "-")}
        yield {f"{len(known)} {what}s": name, **shown}
    print(json.dumps(limits, indent=1))
    if write:
        write_limits(
            {"scene": {"beside": limits}} if what == "part" else {what: limits}
        )


def read_rows(path: Path) -> tuple[str, list[Row]]:
    """The "edit"s, "scene"s or "part"s of a file. Raises InputError for what is none of them."""
    try:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        kinds = ("edit", {"fault"}), ("part", {"strength"}), ("scene", {"label"})
        for what, needed in kinds:
            if all(needed | {"place", "figures"} <= {*row} for row in rows):
                return what, rows
        raise ValueError("a row lacks place, figures, or fault, strength or label")
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: {error}; expected rows of benchmarks/verdict.py."
        ) from None


def write_limits(limits: Limits) -> None:
    """Put limits into the package; what is not in `limits` stays, and the comment on top."""
    fitted = signals.FITTED

    def merged(old: Any, new: Any) -> Any:
        if isinstance(new, Mapping):
            return old | {key: merged(old.get(key, {}), new[key]) for key in new}
        return float(f"{new:.3g}")

    comment = [line for line in fitted.read_text().splitlines(True) if line[0] == "#"]
    kept = yaml.safe_dump(merged(read_yaml(fitted), limits), sort_keys=False)
    fitted.write_text("".join(comment) + kept)


def limits_of_edits(rows: Sequence[Row]) -> Limits:
    """For each signal the limit between edits without a fault and those with its own; good ones
    count twice: at once, the limit of `torn` differs from place to place.
    """
    limits = {}
    for name, signal in SIGNALS.items():
        sign = -1 if signal.at_least else 1
        figures = [(row["fault"], row["figures"][name]) for row in rows]
        good, bad = (
            [sign * one for fault, one in figures if fault == what and one is not None]
            for what in (None, name)
        )
        limits[name] = sign * between(good, bad, 2)
    return limits


def limits_of_scenes(rows: Sequence[Row]) -> Limits:
    """By label the limit half-way between scenes that deserve it and those that do not."""
    limits: dict[str, Any] = {}
    for number, label in enumerate(FITTED_LABELS):
        both: tuple[list[float], list[float]] = [], []
        for row in rows:
            both[LABELS.index(row["label"]) > number].append(row["figures"]["half_way"])
        limits[label] = {"half_way": between(*both)}
    return limits


def is_sound(row: Row) -> bool:
    """Whether nothing is broken, nor the scene poor without that."""
    return not row["strength"] and not _is_poor(row)


def _is_poor(row: Row) -> bool:
    """Whether the view half-way alone makes a scene poor."""
    return row["figures"]["half_way"] > fitted_limits("scene")["fair"]["half_way"]


def limits_of_parts(rows: Sequence[Row]) -> Limits:
    """Half-way between the worst sound part and what nine of ten reach that are broken so much that
    one sees it: a limit just above the sound ones that were fitted would blame others.
    """
    sound = [row["figures"] for row in rows if is_sound(row)]
    broken = [row for row in rows if row["strength"] >= MUST]
    bad: dict[str, list[float]] = {"geometry": [], "reference": [], "flat": []}
    for row in broken:
        figures, kind = row["figures"], row["kind"]
        bad["reference" if kind in BLURRED else "geometry"].append(
            figures["reference" if kind in BLURRED else "geometry"]
        )
        if kind in NO_DEPTH and figures["flat"] is not None:
            # as if the run's geometry were so, and not what was made of it
            bad["flat"].append(figures["flat"] * figures["geometry"])
    limits = {}
    for name, values in bad.items():
        worst = max(one[name] for one in sound if one[name] is not None)
        limits[name] = (worst + quantiles(values, n=10)[0]) / 2
    return limits


def between(good: Sequence[float], bad: Sequence[float], over: float = 1) -> float:
    """The limit above which the least share of `good` values, which counts `over` times, and below
    which the least of `bad` ones lies; of equal limits the middle of the widest gap.
    """

    def rank(pair: tuple[float, float]) -> tuple[float, float]:
        beyond = over * sum(value >= pair[1] for value in good) / len(good)
        below = sum(value <= pair[0] for value in bad) / len(bad)
        return -round(beyond + below, 9), pair[1] - pair[0]

    low, high = max(pairwise(sorted({*good, *bad})), key=rank)
    return (low + high) / 2


def outcomes_of_scenes(row: Row, limits: Limits) -> Outcomes:
    """How often `good`, and `good` or `fair`, is right, and which of the two errors is made."""
    for number, label in enumerate(FITTED_LABELS):
        called = " or ".join(LABELS[: number + 1])
        said = row["figures"]["half_way"] <= limits[label]["half_way"]
        right = said == (LABELS.index(row["label"]) <= number)
        yield f"{called} or not", right
        yield f"  {'' if said else 'not '}called {called}", right


def outcomes_of_parts(row: Row, limits: Limits) -> Outcomes:
    """How often what a broken reconstructor makes is poor, by kind and strength, and a sound one is
    not blamed.
    """
    figures, strength = row["figures"], row["strength"]
    blamed = any(figures[name] > limits[name] for name in ("geometry", "reference"))
    told = blamed or _is_poor(row)
    if is_sound(row):
        yield "sound ones not blamed", not told
    elif strength >= MUST:
        yield "broken ones told", told
    yield f"  {row['kind']} {strength or ''} told", told
    if is_sound(row) and figures["flat"] is not None:
        yield "geometry not blamed", figures["flat"] <= limits["flat"]


def outcomes_of_edits(row: Row, limits: Limits) -> Outcomes:
    """How often the verdict is right, and how often each kind of fault is named as that."""
    fault, said = row["fault"], faults_of(row["figures"], limits)
    if not said:
        yield "called good", fault is None
    if fault is None:
        yield "good ones not doubted", not said
    yield f"  {row['kind']} called {fault or 'good'}", fault in (said or [None])


def counted(outcomes: Iterable[Outcomes]) -> dict[str, str]:
    """How often each outcome was right."""
    found: dict[str, list[bool]] = {}
    for what, right in chain.from_iterable(outcomes):
        found.setdefault(what, []).append(right)
    return {
        what: f"{sum(all_)} of {len(all_)} ({sum(all_) / len(all_):.1%})"
        for what, all_ in sorted(found.items())
    }


WAYS = {
    "edit": (limits_of_edits, outcomes_of_edits),
    "scene": (limits_of_scenes, outcomes_of_scenes),
    "part": (limits_of_parts, outcomes_of_parts),
}
"""How limits are fitted, and what is counted."""


if __name__ == "__main__":
    run_benchmark(main)
