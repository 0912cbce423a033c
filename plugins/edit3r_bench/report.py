"""A benchmark's report: means over scenes with intervals, differences between methods, times."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence, Sized
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from edit3r.contract.errors import InputError
from edit3r.kit.command.results import (
    make_folder,
    markdown_table,
    write_json,
    write_text,
)
from edit3r.kit.photos.images import evenly
from edit3r_bench.intervals import CONFIDENCE, Interval, holm, mean_over_scenes
from edit3r_bench.manifest import EDIT_TYPES
from edit3r_bench.measures import BY_REGION, METRICS
from edit3r_bench.method import Method
from edit3r_bench.page import write_page
from edit3r_bench.run import RESULTS, RUN, ItemResult, read_results, read_run

MEASURES = METRICS | BY_REGION
WALL = ("editor", "scene", "rendering")  # parts of the time of an edit
CPU = ("editor_cpu", "scene_cpu", "rendering_cpu")

EXPLANATION = """\
Means over scenes. In brackets the 95 % interval of Student's t over scenes, from five scenes on.
Truth measures (psnr, ssim, edit-uptake) are taken at held-back views and a failure counts in them
as a black image; measures without truth leave failures out, and the score counts them as 0.
`c-fid-effnet` and `c-kid-effnet` are not FID and KID: their features are those of
EfficientNet-lite0. All four compare five crops of each rendering (itself and its corners) with the
same of this scene's unedited photos, since a scene has too few images: the paper takes images
alone, so its numbers are on another scale. Doing nothing is best by them, as it is by consistency;
by the score it is worst:
(what arrived of the edit) x sqrt(agreement of views x what stayed put)."""

COMPARISON = """\
Differences are taken edit by edit, then scene by scene. "better" and "worse" are what remains at
5 % after Holm's correction for all measures with a direction and all methods of this table."""

TIME_TITLES = (
    *("editor [s CPU]", "scene [s CPU]", "rendering [s CPU]"),
    *("all [s CPU]", "all [s wall]", "a view [s wall]"),
)

TIMES = """\
Seconds for one edit of a scene, all views. The scene is all that a run does between photos and
scene, but for the editor. A view: the scene's wall time over the number of input photos, as in the
paper's Table 1."""


# ---- reading ----


@dataclass(frozen=True)
class Column:
    """One method's results."""

    folder: Path
    run: Mapping[str, Any]  # bench-run.json
    results: Mapping[str, ItemResult]

    @property
    def label(self) -> str:
        """The method's name."""
        return self.run["method"]["label"]

    @property
    def failures(self) -> list[ItemResult]:
        return [result for result in self.results.values() if result.failure]

    @property
    def remarked(self) -> list[ItemResult]:
        """Those in which nothing was edited, or nothing of it is shown."""
        return [result for result in self.results.values() if result.remark]

    @property
    def scenes(self) -> set[str]:
        return {result.scene for result in self.results.values()}

    def only(self, names: Iterable[str]) -> "Column":
        """Return the column with these edits only."""
        results = {name: self.results[name] for name in names}
        return replace(self, results=results)


def read_columns(folders: Iterable[Path]) -> list[Column]:
    """Read every run in the folders, or one level below them, cut to the edits that every method
    has a result of.

    Raises InputError unless all are of one benchmark.
    """
    columns: list[Column] = []
    for folder in map(Path, folders):
        runs = [folder] if (folder / RUN).is_file() else []
        runs = runs or sorted(path.parent for path in folder.glob(f"*/{RUN}"))
        if not runs:
            raise InputError(
                f"{folder}: not a folder of edit3r bench run (it has no {RUN} and {RESULTS}), and "
                "holds none."
            )
        for path in runs:
            column = Column(path, read_run(path), read_results(path))
            _check_column(column, columns)
            columns.append(column)
    shared = set.intersection(*(set(column.results) for column in columns))
    if not shared:
        raise InputError("the runs have no edit in common; nothing to compare.")
    columns.sort(key=lambda column: (column.run.get("position", 0), column.label))
    return [column.only(sorted(shared)) for column in columns]


def _check_column(column: Column, others: Sequence[Column]) -> None:
    for other in others:
        if column.run["manifest_sha256"] != other.run["manifest_sha256"]:
            raise InputError(
                f"{column.folder}: belongs to another benchmark than {other.folder}; report them "
                "separately."
            )
        if column.label == other.label:
            raise InputError(
                f"{column.folder}: a second method is called {column.label!r}; run it with --set "
                "label=..."
            )
    if not column.results:
        raise InputError(
            f"{column.folder}: holds no results yet; finish its edit3r bench run."
        )


def measured_names(columns: Sequence[Column]) -> list[str]:
    """Return what at least one method has a value of, in the order of reports."""
    names: set[str] = set()
    for column in columns:
        for result in column.results.values():
            names |= set(result.metrics)
    return [name for name in MEASURES if name in names]


# ---- means and differences ----


def mean_of(column: Column, name: str, minus: Column | None = None) -> Interval | None:
    """Return the mean over scenes of a measure; None when the method has no value.

    With `minus` of the difference to another method, edit by edit, which is surer than two means.
    """
    values: dict[str, list[float]] = {}
    for result in column.results.values():
        value = result.metrics.get(name, math.nan)
        if minus is not None:
            value -= minus.results[result.id].metrics.get(name, math.nan)
        values.setdefault(result.scene, []).append(value)
    return mean_over_scenes(values)


def verdicts(
    differences: Mapping[str, Mapping[str, Interval | None]],
) -> dict[tuple[str, str], str]:
    """Return "better" or "worse" by method and measure, of differences to the methods, where
    Holm's correction for all of them leaves one; "" else.
    """
    tested: dict[tuple[str, str], Interval] = {}
    p_values: list[float] = []
    for label, own in differences.items():
        for name, interval in own.items():
            if interval and interval.p_value is not None and MEASURES[name].better:
                tested[label, name] = interval
                p_values.append(interval.p_value)
    corrected = holm(p_values)
    words = {}
    for (key, interval), p_value in zip(tested.items(), corrected):
        if p_value < 1 - CONFIDENCE:
            rises = interval.mean > 0
            is_better = rises == (MEASURES[key[1]].better == "↑")
            words[key] = "better" if is_better else "worse"
    return words


def timing(column: Column) -> dict[str, Any]:
    """Median seconds of warm edits, those of the cold one, and how many were warm."""
    times = [result.timing for result in column.results.values() if result.timing]
    cold = [own for own in times if own["cold"]]
    warm = [own for own in times if not own["cold"]]
    medians = {}
    if warm:
        for name in (*CPU, *WALL):
            medians[name] = statistics.median(own[name] for own in warm)
        medians["view"] = statistics.median(own["scene"] / own["views"] for own in warm)
    return {
        "warm": medians or None,
        "warm_edits": len(warm),
        "cold": cold[0] if cold else None,
    }


def summary_of(columns: Sequence[Column]) -> dict[str, Any]:
    """All means as JSON data, without times: the same on every run of manifest and methods."""
    names = measured_names(columns)
    methods = {}
    for column in columns:
        means = {name: mean_of(column, name) for name in names}
        methods[column.label] = {
            "method": column.run["method"],
            "failures": {result.id: result.failure for result in column.failures},
            "metrics": {name: mean and asdict(mean) for name, mean in means.items()},
        }
    return {
        "manifest_sha256": columns[0].run["manifest_sha256"],
        "items": sorted(columns[0].results),
        "methods": methods,
    }


# ---- writing ----


def write_report(columns: Sequence[Column], out: Path, edits_shown: int = 20) -> str:
    """Write report.md, report.json and index.html; return the main table and the times."""
    make_folder(out)
    text = report_text(columns)
    write_text(out / "report.md", text)
    times = {column.label: timing(column) for column in columns}
    write_json(out / "report.json", {**summary_of(columns), "timing": times})
    folders = {column.label: column.folder for column in columns}
    edits = evenly(list(columns[0].results), edits_shown)
    write_page(out / "index.html", text, folders, edits)
    return f"{main_table(columns)}\n\n{time_table(columns)}\n"


def report_text(columns: Sequence[Column]) -> str:
    """Return the report in Markdown."""
    first, *others = columns
    names = measured_names(columns)
    regions = [name for name in names if name in BY_REGION]
    parts = [
        f"# {first.run['manifest'] or 'Benchmark'}",
        f"Manifest {first.run['manifest_sha256'][:12]}, {len(first.results)} edits of "
        f"{len(first.scenes)} scenes.",
        "\n".join(map(_note, columns)),
        EXPLANATION,
        "## Main comparison",
        main_table(columns),
    ]
    if others:
        parts.append(f"## {first.label} against the others")
        parts += [COMPARISON, difference_table(first, others, names)]
    parts += ["## By region", _mean_table(columns, regions), "## By type of edit"]
    parts += [_types_table(columns, n) for n in ("score", "psnr-in-edit") if n in names]
    parts += ["## Time", TIMES, time_table(columns)]
    failures = {column.label: column.failures for column in columns}
    remarked = {column.label: column.remarked for column in columns}
    parts += ["## Failures", _listed(failures)]
    parts += ["## Edits that did nothing", _listed(remarked)]
    return "\n\n".join(parts) + "\n"


def _note(column: Column) -> str:
    """Return a line that says what was run under the column's label."""
    method = Method(**column.run["method"])
    parts = []
    for kind in ("editor", "reconstructor"):
        choice = getattr(method, kind)
        settings = ", ".join(f"{key}={value}" for key, value in choice.settings.items())
        parts.append(f"{kind} `{choice.name}`" + (f" ({settings})" if settings else ""))
    note = f"; {method.note}" if method.note else ""
    return f"- **{column.label}**: {', '.join(parts)}{note}"


def _listed(results: Mapping[str, Sequence[ItemResult]]) -> str:
    lines = [
        f"- {label}, {result.id}: {result.failure or result.remark}"
        for label, own in results.items()
        for result in own
    ]
    return "\n".join(lines) or "None."


# ---- tables ----


def main_table(columns: Sequence[Column]) -> str:
    """Return the table of all measures (rows) of all methods (columns)."""
    counts: dict[str, list[Sized]] = {
        "edits": [column.results for column in columns],
        "failed": [column.failures for column in columns],
        "nothing edited, or nothing of it shown": [own.remarked for own in columns],
    }
    rows = []
    for what, own in counts.items():
        row = {"": what, "scenes": str(len(columns[0].scenes))}
        for column, results in zip(columns, own):
            row[column.label] = str(len(results))
        rows.append(row)
    names = [name for name in measured_names(columns) if name in METRICS]
    return _mean_table(columns, names, rows)


def _mean_table(
    columns: Sequence[Column],
    names: Sequence[str],
    first: Sequence[dict[str, str]] = (),
) -> str:
    rows = [_row(title(name), columns, name) for name in names]
    return markdown_table([*first, *rows])


def _types_table(columns: Sequence[Column], name: str) -> str:
    """Return the table of one measure by type of edit."""
    rows = []
    for kind in EDIT_TYPES:
        edits = [own.id for own in columns[0].results.values() if own.type == kind]
        if edits:
            own = [column.only(edits) for column in columns]
            rows.append(_row(f"{title(name)}, {kind}", own, name))
    return markdown_table(rows)


def _row(head: str, columns: Sequence[Column], name: str) -> dict[str, str]:
    """Return the number of scenes, and the mean of each method."""
    means = {column.label: mean_of(column, name) for column in columns}
    cells = {label: _cell(mean, name) for label, mean in means.items()}
    return {"": head, "scenes": _scenes(means.values()), **cells}


def difference_table(
    first: Column, others: Sequence[Column], names: Sequence[str]
) -> str:
    """Return the table of what the first method has more than the others, edit by edit."""
    differences = {}
    for other in others:
        own = {name: mean_of(first, name, minus=other) for name in names}
        differences[other.label] = own
    words = verdicts(differences)
    rows = []
    for name in names:
        intervals = {label: own[name] for label, own in differences.items()}
        row = {"": title(name), "scenes": _scenes(intervals.values())}
        for label, interval in intervals.items():
            verdict = words.get((label, name), "")
            cell = f"{_cell(interval, name, '+')} {verdict}"
            row[f"{first.label} - {label}"] = cell.rstrip()
        rows.append(row)
    return markdown_table(rows)


def time_table(columns: Sequence[Column]) -> str:
    """Return seconds an edit of a scene (all its views): warm medians by part, of the scene also a
    view, and the whole of the cold first one.
    """
    rows = []
    for column in columns:
        times = timing(column)
        row = {"": column.label, "warm edits": str(times["warm_edits"])}
        seconds: dict[str, float | None] = dict.fromkeys(TIME_TITLES)
        if warm := times["warm"]:
            parts = [warm[name] for name in CPU]
            wall = sum(warm[name] for name in WALL)
            seconds = dict(zip(TIME_TITLES, (*parts, sum(parts), wall, warm["view"])))
        cold = times["cold"] and sum(times["cold"][name] for name in CPU)
        seconds["cold: all [s CPU]"] = cold
        cells = {
            title: "-" if s is None else f"{s:.3g}" for title, s in seconds.items()
        }
        rows.append(row | cells)
    return markdown_table(rows)


def title(name: str) -> str:
    return f"{name} {MEASURES[name].better}".strip()


def _scenes(intervals: Iterable[Interval | None]) -> str:
    """Return how many scenes have a value, "4 to 5" where methods differ in that."""
    counts = {interval.scenes for interval in intervals if interval} or {0}
    return " to ".join(map(str, sorted({min(counts), max(counts)})))


def _cell(interval: Interval | None, name: str, sign: str = "") -> str:
    if interval is None:
        return "-"
    form = sign + MEASURES[name].form
    mean = format(interval.mean, form)
    if interval.low is None:
        return mean
    return f"{mean} ({interval.low:{form}}, {interval.high:{form}})"
