"""Results of several methods on the same edits as means with intervals, and as differences between methods."""

import json
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edit3r.errors import InputError
from edit3r_measure.bench.measure import METRIC_ORDER
from edit3r_measure.bench.results import RESULTS, RUN, ItemResult, read_results
from edit3r_measure.bench.score import score
from edit3r_measure.evaluation.bootstrap import Interval, bootstrap_mean

__all__ = ["TIMES", "Column", "common_items", "difference", "mean_of", "metric_names", "read_columns", "timing"]

SCORE = "score"
TIMES = ("editor_cpu", "network_cpu", "rendering_cpu", "editor", "network", "rendering")


@dataclass(frozen=True)
class Column:
    """One method's results."""

    folder: Path
    run: Mapping[str, Any]  # bench-run.json
    results: Mapping[str, ItemResult]

    @property
    def label(self) -> str:
        return self.run["method"]["label"]

    @property
    def failures(self) -> list[ItemResult]:
        return [result for result in self.results.values() if result.failure]

    def of_type(self, kind: str) -> "Column":
        """Only edits of one type."""
        return Column(self.folder, self.run, {k: r for k, r in self.results.items() if r.type == kind})


def read_columns(folders: Iterable[Path]) -> list[Column]:
    """Every run in the folders, or one level below them. Raises InputError unless all are of one benchmark."""
    found = [run for folder in folders for run in _runs_in(Path(folder))]
    columns = []
    for folder in found:
        run = json.loads((folder / RUN).read_text(encoding="utf-8"))
        columns.append(Column(folder, run, read_results(folder)))
    for column in columns:
        if column.run["manifest_sha256"] != columns[0].run["manifest_sha256"]:
            raise InputError(f"{column.folder}: is of another benchmark than {columns[0].folder}; report them apart.")
        if not column.results:
            raise InputError(f"{column.folder}: holds no results yet; finish its edit3r bench run.")
    labels = [column.label for column in columns]
    twice = next((column for column in columns if labels.count(column.label) > 1), None)
    if twice is not None:
        raise InputError(f"{twice.folder}: a second method is called {twice.label!r}; run it with --set label=...")
    return common_items(sorted(columns, key=lambda column: (column.run.get("position", 0), column.label)))


def common_items(columns: Sequence[Column]) -> list[Column]:
    """Only the edits that every method has a result of, failures included: means compare like with like."""
    shared = set.intersection(*(set(column.results) for column in columns))
    if not shared:
        raise InputError("the runs have no edit in common; nothing to compare.")
    return [Column(c.folder, c.run, {k: r for k, r in sorted(c.results.items()) if k in shared}) for c in columns]


def metric_names(columns: Sequence[Column]) -> list[str]:
    """The score, then what at least one method has a value of, in the order of reports."""
    found = {name for column in columns for result in column.results.values() for name in result.metrics}
    return [SCORE, *(name for name in METRIC_ORDER if name in found)]


def value_of(result: ItemResult, name: str) -> float:
    """A metric or the score; NaN when there is none."""
    return score(result) if name == SCORE else result.metrics.get(name, float("nan"))


def mean_of(column: Column, name: str) -> Interval | None:
    """Mean over scenes with its interval; None when the method has no value."""
    return bootstrap_mean(_by_scene(column.results.values(), lambda result: value_of(result, name)))


def difference(column: Column, other: Column, name: str) -> Interval | None:
    """Mean of `column` minus `other`, edit by edit: surer than the two means, for scenes differ more than methods."""
    return bootstrap_mean(
        _by_scene(column.results.values(), lambda r: value_of(r, name) - value_of(other.results[r.id], name))
    )


def timing(column: Column) -> dict[str, Any]:
    """Median seconds of warm edits, those of the cold one, and how many there were."""
    times = [result.timing for result in column.results.values() if result.timing]
    warm, cold = ([t for t in times if t["cold"] is wanted] for wanted in (False, True))
    median = {name: statistics.median(t[name] for t in warm) for name in TIMES} if warm else None
    return {"warm": median, "warm_edits": len(warm), "cold": cold[0] if cold else None}


def _by_scene(results: Iterable[ItemResult], value: Callable[[ItemResult], float]) -> dict[str, list[float]]:
    grouped: dict[str, list[float]] = {}
    for result in results:
        grouped.setdefault(result.scene, []).append(value(result))
    return grouped


def _runs_in(folder: Path) -> list[Path]:
    if (folder / RUN).is_file():
        return [folder]
    inner = sorted(path.parent for path in folder.glob(f"*/{RUN}")) if folder.is_dir() else []
    if not inner:
        raise InputError(f"{folder}: neither a folder of edit3r bench run (it has no {RUN} and {RESULTS}) nor of such.")
    return inner
