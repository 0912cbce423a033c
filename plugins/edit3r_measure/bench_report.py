"""A benchmark's report: means over scenes with intervals, differences between methods, tables and plots."""

import json
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r.reporting import warn
from edit3r_measure.bench_item import RESULTS, RUN, ItemResult, read_results
from edit3r_measure.bench_manifest import EDIT_TYPES
from edit3r_measure.bench_metrics import METRICS, score
from edit3r_measure.bench_page import MethodStrips, PageEdit, write_page
from edit3r_measure.metrics import Interval, bootstrap_mean
from edit3r_measure.report import format_or_dash, markdown_table

WALL = ("editor", "network", "rendering")
CPU = ("editor_cpu", "network_cpu", "rendering_cpu")

EXPLANATION = """\
Means over scenes, in brackets the 95 % interval of a bootstrap over scenes. Truth measures (psnr, ssim, edit-uptake)
are taken at held-back views and a failure counts in them as a black picture; measures without truth leave failures
out, and the score counts them as 0. `c-fid-effnet` and `c-kid-effnet` are not FID and KID: their features are those
of EfficientNet-lite0. C-FID and C-KID compare with the unedited photos, so doing nothing is best by them, as it is by
consistency; by the score it is worst: (what arrived of the edit) x sqrt(agreement of views x what stayed put)."""

PLOTTED = ("score", "psnr-in-edit", "edit-uptake", "consistency-held-back", "clip-t2i", "c-kid", "c-kid-effnet")
PALETTE = ("#2f6f9f", "#d1782f", "#5b8c5a", "#8d6a9f", "#b8505c", "#6b6b6b", "#a08a3c", "#3f8f8a")


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
        """The results that are failures."""
        return [result for result in self.results.values() if result.failure]

    def of_type(self, kind: str) -> "Column":
        """Return the column with the edits of one type only."""
        return Column(self.folder, self.run, {k: r for k, r in self.results.items() if r.type == kind})


def read_columns(folders: Iterable[Path]) -> list[Column]:
    """Read every run in the folders, or one level below them. Raises InputError unless all are of one benchmark."""
    columns = []
    for folder in folders:
        for path in _runs_in(Path(folder)):
            run = json.loads((path / RUN).read_text(encoding="utf-8"))
            columns.append(Column(path, run, read_results(path)))
    for column in columns:
        if column.run["manifest_sha256"] != columns[0].run["manifest_sha256"]:
            raise InputError(f"{column.folder}: is of another benchmark than {columns[0].folder}; report them apart.")
        if not column.results:
            raise InputError(f"{column.folder}: holds no results yet; finish its edit3r bench run.")
    labels = [column.label for column in columns]
    for column in columns:
        if labels.count(column.label) > 1:
            raise InputError(
                f"{column.folder}: a second method is called {column.label!r}; run it with --set label=..."
            )
    return _common_items(sorted(columns, key=lambda column: (column.run.get("position", 0), column.label)))


def _runs_in(folder: Path) -> list[Path]:
    if (folder / RUN).is_file():
        return [folder]
    inner = sorted(path.parent for path in folder.glob(f"*/{RUN}")) if folder.is_dir() else []
    if not inner:
        raise InputError(f"{folder}: neither a folder of edit3r bench run (it has no {RUN} and {RESULTS}) nor of such.")
    return inner


def _common_items(columns: Sequence[Column]) -> list[Column]:
    """Keep the edits that every method has a result of, failures included: means compare like with like."""
    shared = set.intersection(*(set(column.results) for column in columns))
    if not shared:
        raise InputError("the runs have no edit in common; nothing to compare.")
    return [Column(c.folder, c.run, {k: r for k, r in sorted(c.results.items()) if k in shared}) for c in columns]


def metric_names(columns: Sequence[Column]) -> list[str]:
    """Return the score, then what at least one method has a value of, in the order of reports."""
    found = {name for column in columns for result in column.results.values() for name in result.metrics}
    return [name for name in METRICS if name == "score" or name in found]


def value_of(result: ItemResult, name: str) -> float:
    """Return a metric or the score; NaN when there is none."""
    return score(result.metrics, result.failure) if name == "score" else result.metrics.get(name, float("nan"))


def mean_of(column: Column, name: str) -> Interval | None:
    """Return the mean over scenes with its interval; None when the method has no value."""
    return _mean_over_scenes(column, lambda result: value_of(result, name))


def difference(column: Column, other: Column, name: str) -> Interval | None:
    """Return the mean of `column` minus `other`, edit by edit: surer than the two means, for scenes differ more."""
    return _mean_over_scenes(column, lambda result: value_of(result, name) - value_of(other.results[result.id], name))


def _mean_over_scenes(column: Column, value: Callable[[ItemResult], float]) -> Interval | None:
    by_scene: dict[str, list[float]] = {}
    for result in column.results.values():
        by_scene.setdefault(result.scene, []).append(value(result))
    return bootstrap_mean(by_scene)


def timing(column: Column) -> dict[str, Any]:
    """Return median seconds of warm edits, those of the cold one, and how many warm ones there were."""
    times = [result.timing for result in column.results.values() if result.timing]
    warm, cold = ([t for t in times if t["cold"] is wanted] for wanted in (False, True))
    median = {name: statistics.median(t[name] for t in warm) for name in (*CPU, *WALL)} if warm else None
    return {"warm": median, "warm_edits": len(warm), "cold": cold[0] if cold else None}


def write_report(columns: Sequence[Column], out: Path, edits_shown: int = 20) -> str:
    """Write report.md, report.json, plots and index.html into `out`, and return the main table and the times."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be created ({error.strerror}); give --out another folder.") from None
    text = report_text(columns)
    with atomic_write(out / "report.md") as partial:
        partial.write_text(text, encoding="utf-8")
    with atomic_write(out / "report.json") as partial:
        content = {**summary_of(columns), "timing": {column.label: timing(column) for column in columns}}
        partial.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    edits = [_edit_on_page(columns, result) for result in columns[0].results.values()]
    write_page(out / "index.html", text, write_plots(columns, out), edits, edits_shown)
    return f"{main_table(columns)}\n\n{time_table(columns)}\n"


def _edit_on_page(columns: Sequence[Column], edit: ItemResult) -> PageEdit:
    strips = [
        MethodStrips(column.label, column.folder / "pictures" / edit.id, value_of(own, "score"), own.failure)
        for column in columns
        for own in [column.results[edit.id]]
    ]
    return PageEdit(f"{edit.id} ({edit.type})", strips)


def summary_of(columns: Sequence[Column]) -> dict[str, Any]:
    """Return all means as JSON data: a function of manifest and methods alone, so the same on every run; no times."""
    names = metric_names(columns)
    return {
        "manifest_sha256": columns[0].run["manifest_sha256"],
        "items": sorted(columns[0].results),
        "methods": {
            column.label: {
                "method": column.run["method"],
                "failures": {result.id: result.failure for result in column.failures},
                "metrics": {name: (mean := mean_of(column, name)) and asdict(mean) for name in names},
            }
            for column in columns
        },
    }


def report_text(columns: Sequence[Column]) -> str:
    """Return the report in Markdown."""
    run, count = columns[0].run, len(columns[0].results)
    scenes = len({result.scene for result in columns[0].results.values()})
    parts = [
        f"# {run['manifest'] or 'Benchmark'}",
        f"Manifest {run['manifest_sha256'][:12]}, {count} edits of {scenes} scenes.",
        "\n".join(map(_note, columns)),
        EXPLANATION,
        "## Main comparison",
        main_table(columns),
    ]
    if len(columns) > 1:
        parts += [f"## {columns[0].label} against the others, edit by edit", differences_table(columns[0], columns[1:])]
    by_type = [name for name in ("score", "psnr-in-edit") if name in metric_names(columns)]
    parts += ["## By type of edit", *(types_table(columns, name) for name in by_type)]
    parts += ["## Time", "Seconds for one edit of a scene, all views.", time_table(columns)]
    failures = [f"- {column.label}, {result.id}: {result.failure}" for column in columns for result in column.failures]
    return "\n\n".join([*parts, "## Failures", "\n".join(failures) or "None."]) + "\n"


def _note(column: Column) -> str:
    """Return a line that says what was run under the column's label."""
    method = column.run["method"]
    parts = []
    for kind in ("editor", "reconstructor"):
        settings = ", ".join(f"{key}={value}" for key, value in method[kind]["settings"].items())
        parts.append(f"{kind} `{method[kind]['name']}`" + (f" ({settings})" if settings else ""))
    return f"- **{column.label}**: {', '.join(parts)}" + (f"; {method['note']}" if method["note"] else "")


def main_table(columns: Sequence[Column]) -> str:
    """Return the table of all metrics (rows) of all methods (columns)."""
    counts = [
        ["edits", *(str(len(column.results)) for column in columns)],
        ["failed", *(str(len(column.failures)) for column in columns)],
    ]
    rows = [[_title(name), *(_cell(mean_of(c, name), name) for c in columns)] for name in metric_names(columns)]
    return markdown_table(_head("", columns), [*counts, *rows])


def differences_table(first: Column, others: Sequence[Column]) -> str:
    """Return the table of the first method minus each other one, edit by edit."""
    names = metric_names([first, *others])
    rows = [[_title(name), *(_cell(difference(first, c, name), name, "+") for c in others)] for name in names]
    return markdown_table(["", *(f"{first.label} - {other.label}" for other in others)], rows)


def types_table(columns: Sequence[Column], name: str) -> str:
    """Return the table of one metric by type of edit."""
    kinds = [kind for kind in EDIT_TYPES if columns[0].of_type(kind).results]
    rows = [[kind, *(_cell(mean_of(c.of_type(kind), name), name) for c in columns)] for kind in kinds]
    return markdown_table(_head(_title(name), columns), rows)


def time_table(columns: Sequence[Column]) -> str:
    """Return seconds an edit of a scene (all its views): warm medians by part, and the whole of the cold first one."""
    titles = {
        "editor, warm [s CPU]": ("warm", CPU[:1]),
        "reconstruction, warm [s CPU]": ("warm", CPU[1:2]),
        "rendering, warm [s CPU]": ("warm", CPU[2:]),
        "all three, warm [s CPU]": ("warm", CPU),
        "all three, warm [s wall]": ("warm", WALL),
        "all three, cold [s CPU]": ("cold", CPU),
    }
    times = [timing(column) for column in columns]
    rows = [
        [title, *(format_or_dash(t[which] and sum(t[which][name] for name in names), ".3g") for t in times)]
        for title, (which, names) in titles.items()
    ]
    rows.append(["warm edits", *(format(time["warm_edits"], ".3g") for time in times)])
    return markdown_table(_head("", columns), rows)


def _head(corner: str, columns: Sequence[Column]) -> list[str]:
    return [corner, *(column.label for column in columns)]


def _title(name: str) -> str:
    return f"{name} {METRICS[name][0]}".strip()


def _cell(interval: Interval | None, name: str, sign: str = "") -> str:
    if interval is None:
        return "-"
    mean, low, high = (format(value, sign + METRICS[name][1]) for value in (interval.mean, interval.low, interval.high))
    return mean if interval.scenes < 2 else f"{mean} ({low}, {high})"


def write_plots(columns: Sequence[Column], out: Path) -> list[Path]:
    """Write measures.svg and quality-time.svg; none, with a warning, without matplotlib (extra `bench`)."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        warn('no plots: matplotlib is not installed; install with: pip install "edit3r[bench]"')
        return []
    names = [name for name in PLOTTED if name in metric_names(columns)]
    with matplotlib.rc_context({"svg.hashsalt": "edit3r", "font.size": 9}):
        bars = Figure(figsize=(2.3 * len(names), 2.8), layout="constrained")
        for axes, name in zip(bars.subplots(1, len(names), squeeze=False)[0], names):
            _draw_bars(axes, columns, name)
        points = Figure(figsize=(4.6, 3.2), layout="constrained")
        _draw_score_over_time(points.subplots(), columns)
        paths = {out / "measures.svg": bars, out / "quality-time.svg": points}
        for path, figure in paths.items():
            with atomic_write(path) as partial:
                figure.savefig(partial, metadata={"Date": None})
    return list(paths)


def _draw_bars(axes: Any, columns: Sequence[Column], name: str) -> None:
    """Draw one bar a method for one metric, with whiskers for the 95 % interval."""
    for place, column in enumerate(columns):
        mean = mean_of(column, name)
        if mean is not None:
            color = PALETTE[place % len(PALETTE)]
            axes.bar(place, mean.mean, yerr=_whiskers(mean), color=color, capsize=3, width=0.7)
    axes.set_title(name, fontsize=9)
    axes.set_xticks(range(len(columns)), [column.label for column in columns], rotation=40, ha="right")
    axes.spines[["top", "right"]].set_visible(False)


def _draw_score_over_time(axes: Any, columns: Sequence[Column]) -> None:
    """Draw one point a method: its score over the CPU seconds of a warm edit, on a logarithmic axis."""
    for place, column in enumerate(columns):
        warm, mean = timing(column)["warm"], mean_of(column, "score")
        if warm is None or mean is None:
            continue
        seconds = warm["editor_cpu"] + warm["network_cpu"]
        color = PALETTE[place % len(PALETTE)]
        axes.errorbar(seconds, mean.mean, yerr=_whiskers(mean), fmt="o", color=color, capsize=3)
        axes.annotate(f" {column.label}", (seconds, mean.mean), fontsize=8, va="bottom")
    axes.set_xscale("log")
    axes.margins(x=0.25)
    axes.set_xlabel("editing and reconstructing a scene, warm [s CPU]")
    axes.set_ylabel("score")
    axes.spines[["top", "right"]].set_visible(False)


def _whiskers(mean: Interval) -> list[list[float]]:
    """Return how far the interval reaches below and above its mean, as matplotlib wants it."""
    return [[mean.mean - mean.low], [mean.high - mean.mean]]
