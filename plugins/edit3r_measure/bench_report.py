"""A benchmark's report: means over scenes with intervals, differences between methods, tables, and
a page of images.
"""

import base64
import html
import io
import json
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from PIL import Image

from edit3r.errors import InputError
from edit3r.io.decode import FORMATS
from edit3r.io.images import evenly
from edit3r_measure.bench_item import RESULTS, RUN, ItemResult, read_results
from edit3r_measure.bench_manifest import EDIT_TYPES
from edit3r_measure.bench_metrics import BY_REGION, METRICS
from edit3r_measure.metrics import Interval, bootstrap_mean
from edit3r_measure.report import (
    format_or_dash,
    grouped,
    make_folder,
    markdown_table,
    write_json,
    write_text,
)

FORMS = {**METRICS, **BY_REGION}  # better direction and number format of every measure

WALL = ("editor", "network", "rendering")
CPU = ("editor_cpu", "network_cpu", "rendering_cpu")

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1rem; color: #1c1c1e;
  background: #faf9f7 }
table { border-collapse: collapse; font-size: 13px; margin: 1rem 0; display: block; overflow-x: auto }
td, th { padding: .25rem .7rem; border-bottom: 1px solid #dedbd5; text-align: right; font-weight: normal }
th { border-bottom: 2px solid #b9b5ad } td:first-child, th:first-child { text-align: left }
.item { margin: 2.2rem 0 } .strips { display: grid; grid-template-columns: max-content 1fr; gap: .25rem .8rem }
.strips span { font-size: 13px; color: #6a6762; align-self: center; max-width: 15rem }
.strips img { max-width: 100%; display: block } .failed { color: #b8505c }
"""
HEIGHT = 128  # strips are reduced to this height [pixels]

EXPLANATION = """\
Means over scenes, in brackets the 95 % interval of a bootstrap over scenes. Truth measures (psnr, ssim, edit-uptake)
are taken at held-back views and a failure counts in them as a black picture; measures without truth leave failures
out, and the score counts them as 0. `c-fid-effnet` and `c-kid-effnet` are not FID and KID: their features are those
of EfficientNet-lite0. C-FID and C-KID compare with the unedited photos, so doing nothing is best by them, as it is by
consistency; by the score it is worst: (what arrived of the edit) x sqrt(agreement of views x what stayed put)."""


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
        return replace(
            self, results={k: r for k, r in self.results.items() if r.type == kind}
        )


def read_columns(folders: Iterable[Path]) -> list[Column]:
    """Read every run in the folders, or one level below them, cut to the edits that every method
    has a result of.

    Raises InputError unless all are of one benchmark.
    """
    columns = []
    for folder in map(Path, folders):
        paths = (
            [folder]
            if (folder / RUN).is_file()
            else sorted(path.parent for path in folder.glob(f"*/{RUN}"))
        )
        if not paths:
            lacking = f"neither a folder of edit3r bench run (it has no {RUN} and {RESULTS}) nor of such"
            raise InputError(f"{folder}: {lacking}.")
        columns += [
            Column(
                p, json.loads((p / RUN).read_text(encoding="utf-8")), read_results(p)
            )
            for p in paths
        ]
    labels = [column.label for column in columns]
    for column in columns:
        if column.run["manifest_sha256"] != columns[0].run["manifest_sha256"]:
            raise InputError(
                f"{column.folder}: is of another benchmark than {columns[0].folder}; report them "
                "apart."
            )
        if not column.results:
            raise InputError(
                f"{column.folder}: holds no results yet; finish its edit3r bench run."
            )
    for column in columns:
        if labels.count(column.label) > 1:
            again = f"a second method is called {column.label!r}; run it with --set label=..."
            raise InputError(f"{column.folder}: {again}")
    shared = set.intersection(*(set(column.results) for column in columns))
    if not shared:
        raise InputError("the runs have no edit in common; nothing to compare.")
    columns.sort(key=lambda column: (column.run.get("position", 0), column.label))
    return [
        replace(c, results={name: c.results[name] for name in sorted(shared)})
        for c in columns
    ]


def metric_names(columns: Sequence[Column]) -> list[str]:
    """Return what at least one method has a value of, in the order of reports."""
    found = {
        name
        for column in columns
        for result in column.results.values()
        for name in result.metrics
    }
    return [name for name in (*METRICS, *BY_REGION) if name in found]


def mean_of(column: Column, name: str, minus: Column | None = None) -> Interval | None:
    """Return the mean over scenes of a metric with its interval; None when the method has no value.

    With `minus` of the difference to another method, edit by edit, which is surer than two means.
    """

    def value(result: ItemResult) -> float:
        other = (
            0.0
            if minus is None
            else minus.results[result.id].metrics.get(name, math.nan)
        )
        return result.metrics.get(name, math.nan) - other

    scenes = grouped(column.results.values(), lambda result: result.scene)
    return bootstrap_mean(
        {scene: list(map(value, results)) for scene, results in scenes.items()}
    )


def timing(column: Column) -> dict[str, Any]:
    """Return median seconds of warm edits, those of the cold one, and how many warm ones there
    were.
    """
    times = [result.timing for result in column.results.values() if result.timing]
    warm, cold = ([t for t in times if t["cold"] is wanted] for wanted in (False, True))
    median = (
        {name: statistics.median(t[name] for t in warm) for name in (*CPU, *WALL)}
        if warm
        else None
    )
    return {"warm": median, "warm_edits": len(warm), "cold": cold[0] if cold else None}


def summary_of(columns: Sequence[Column]) -> dict[str, Any]:
    """Return all means as JSON data: a function of manifest and methods alone, so the same on every
    run; no times.
    """
    names = metric_names(columns)
    return {
        "manifest_sha256": columns[0].run["manifest_sha256"],
        "items": sorted(columns[0].results),
        "methods": {
            column.label: {
                "method": column.run["method"],
                "failures": {result.id: result.failure for result in column.failures},
                "metrics": {
                    name: (mean := mean_of(column, name)) and asdict(mean)
                    for name in names
                },
            }
            for column in columns
        },
    }


def report_text(columns: Sequence[Column]) -> str:
    """Return the report in Markdown."""
    first, others, names = columns[0], columns[1:], metric_names(columns)
    scenes = len({result.scene for result in first.results.values()})
    parts = [
        f"# {first.run['manifest'] or 'Benchmark'}",
        f"Manifest {first.run['manifest_sha256'][:12]}, {len(first.results)} edits of {scenes} "
        "scenes.",
        "\n".join(map(_note, columns)),
        EXPLANATION,
        "## Main comparison",
        main_table(columns),
    ]
    if others:
        rows = [
            [
                title(name),
                *(_cell(mean_of(first, name, minus=c), name, "+") for c in others),
            ]
            for name in names
        ]
        table = markdown_table(
            ["", *(f"{first.label} - {other.label}" for other in others)], rows
        )
        parts += [f"## {first.label} against the others, edit by edit", table]
    parts += ["## By region", region_table(columns)]
    parts += [
        "## By type of edit",
        *(_types_table(columns, n) for n in ("score", "psnr-in-edit") if n in names),
    ]
    parts += [
        "## Time",
        "Seconds for one edit of a scene, all views.",
        time_table(columns),
    ]
    failures = [
        f"- {column.label}, {result.id}: {result.failure}"
        for column in columns
        for result in column.failures
    ]
    remarks = [
        f"- {column.label}, {result.id}: {result.remark}"
        for column in columns
        for result in _remarked(column)
    ]
    parts += [
        "## Failures",
        "\n".join(failures) or "None.",
        "## Edits that did nothing",
        "\n".join(remarks) or "None.",
    ]
    return "\n\n".join(parts) + "\n"


def _remarked(column: Column) -> list[ItemResult]:
    return [result for result in column.results.values() if result.remark]


def _note(column: Column) -> str:
    """Return a line that says what was run under the column's label."""
    method = column.run["method"]
    parts = []
    for kind in ("editor", "reconstructor"):
        settings = ", ".join(
            f"{key}={value}" for key, value in method[kind]["settings"].items()
        )
        parts.append(
            f"{kind} `{method[kind]['name']}`" + (f" ({settings})" if settings else "")
        )
    return f"- **{column.label}**: {', '.join(parts)}" + (
        f"; {method['note']}" if method["note"] else ""
    )


def main_table(columns: Sequence[Column]) -> str:
    """Return the table of all metrics (rows) of all methods (columns)."""
    counts = [
        ["edits", *(str(len(column.results)) for column in columns)],
        ["failed", *(str(len(column.failures)) for column in columns)],
        [
            "nothing edited, or nothing of it shown",
            *(str(len(_remarked(column))) for column in columns),
        ],
    ]
    return _table(
        counts, [name for name in metric_names(columns) if name in METRICS], columns
    )


def region_table(columns: Sequence[Column]) -> str:
    """Return the table of the measures against the truth by region of the picture and kind of
    view.
    """
    return _table(
        [], [name for name in metric_names(columns) if name in BY_REGION], columns
    )


def _table(
    first: list[list[str]], names: Sequence[str], columns: Sequence[Column]
) -> str:
    rows = [
        [title(name), *(_cell(mean_of(c, name), name) for c in columns)]
        for name in names
    ]
    return markdown_table(_head("", columns), [*first, *rows])


def _types_table(columns: Sequence[Column], name: str) -> str:
    """Return the table of one metric by type of edit."""
    kinds = [kind for kind in EDIT_TYPES if columns[0].of_type(kind).results]
    rows = [
        [kind, *(_cell(mean_of(c.of_type(kind), name), name) for c in columns)]
        for kind in kinds
    ]
    return markdown_table(_head(title(name), columns), rows)


def time_table(columns: Sequence[Column]) -> str:
    """Return seconds an edit of a scene (all its views): warm medians by part, and the whole of the
    cold first one.
    """
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
        [
            title,
            *(
                format_or_dash(
                    t[which] and sum(t[which][name] for name in names), ".3g"
                )
                for t in times
            ),
        ]
        for title, (which, names) in titles.items()
    ]
    rows.append(["warm edits", *(format(time["warm_edits"], ".3g") for time in times)])
    return markdown_table(_head("", columns), rows)


def _head(corner: str, columns: Sequence[Column]) -> list[str]:
    return [corner, *(column.label for column in columns)]


def title(name: str) -> str:
    return f"{name} {FORMS[name][0]}".strip()


def _cell(interval: Interval | None, name: str, sign: str = "") -> str:
    if interval is None:
        return "-"
    mean, low, high = (
        format(value, sign + FORMS[name][1])
        for value in (interval.mean, interval.low, interval.high)
    )
    return mean if interval.scenes < 2 else f"{mean} ({low}, {high})"


def write_report(columns: Sequence[Column], out: Path, edits_shown: int = 20) -> str:
    """Write report.md, report.json and index.html into `out`, and return the main table and the
    times.
    """
    make_folder(out)
    text = report_text(columns)
    write_text(out / "report.md", text)
    times = {column.label: timing(column) for column in columns}
    write_json(out / "report.json", {**summary_of(columns), "timing": times})
    write_page(out / "index.html", text, columns, edits_shown)
    return f"{main_table(columns)}\n\n{time_table(columns)}\n"


def write_page(path: Path, text: str, columns: Sequence[Column], most: int) -> None:
    """Write the report `text` (Markdown), and images of at most `most` edits, spread evenly."""
    edits = list(columns[0].results.values()) if columns else []
    shown = evenly(edits, most)
    parts = [MarkdownIt("commonmark", {"html": False}).enable("table").render(text)]
    parts.append(
        f"<h2>Pictures</h2><p>{len(shown)} of {len(edits)} edits, evenly chosen. Frames from "
        "left to right: the inputs "
        "(the first is the reference), then the held-back views.</p>"
    )
    for edit in shown:
        title = f"<h3>{html.escape(f'{edit.id} ({edit.type})')}</h3>"
        parts.append(
            f'<div class="item">{title}<div class="strips">{_strips(columns, edit.id)}</div></div>'
        )
    title = html.escape(text.partition("\n")[0].removeprefix("# "))
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    write_text(path, f"{head}<body>{''.join(parts)}</body></html>\n")


def _strips(columns: Sequence[Column], edit: str) -> str:
    """Return photos and truth once, then each 2D edit with the methods that had it, then what each
    method shows.
    """
    folders = {column.label: column.folder / "pictures" / edit for column in columns}
    rows = []
    for kind in ("photos", "truth"):
        files = [
            file
            for folder in folders.values()
            if (file := folder / f"{kind}.png").is_file()
        ]
        rows += [
            f"<span>{kind}</span>{_embed(file.read_bytes())}" for file in files[:1]
        ]
    edits: dict[bytes, list[str]] = {}
    for label, folder in folders.items():
        if (folder / "edited.png").is_file():
            edits.setdefault((folder / "edited.png").read_bytes(), []).append(label)
    rows += [
        f"<span>2D edit: {html.escape(', '.join(who))}</span>{_embed(image)}"
        for image, who in edits.items()
    ]
    for column in columns:
        result, file = column.results[edit], folders[column.label] / "shown.png"
        label, failure = html.escape(column.label), html.escape(result.failure)
        if failure:
            rows.append(
                f'<span>{label}</span><span class="failed">failed: {failure}</span>'
            )
        elif file.is_file():
            rows.append(
                f"<span>{label}, score "
                f"{result.metrics['score']:.2f}</span>{_embed(file.read_bytes())}"
            )
    return "".join(rows)


def _embed(content: bytes) -> str:
    """Return an image file's content as an `img` tag that holds it as WebP."""
    image = Image.open(io.BytesIO(content), formats=FORMATS).convert("RGB")
    if image.height > HEIGHT:
        image = image.resize(
            (round(image.width * HEIGHT / image.height), HEIGHT),
            Image.Resampling.LANCZOS,
        )
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=88)
    return f'<img alt="" src="data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode("ascii")}">'
