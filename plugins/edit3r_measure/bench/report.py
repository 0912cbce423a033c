"""A report: tables, machine-readable means, plots and one page with the pictures side by side."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r_measure.bench import tables
from edit3r_measure.bench.page import write_page
from edit3r_measure.bench.plots import write_plots
from edit3r_measure.bench.summary import Column, mean_of, metric_names, timing

__all__ = ["summary_of", "write_report"]

EXPLANATION = """\
Means over scenes, in brackets the 95 % interval of a bootstrap over scenes. Truth measures (psnr, ssim, edit-uptake)
are taken at held-back views and a failure counts in them as a black picture; measures without truth leave failures
out, and the score counts them as 0. `c-fid-effnet` and `c-kid-effnet` are not FID and KID: their features are those
of EfficientNet-lite0. C-FID and C-KID compare with the unedited photos, so doing nothing is best by them, as it is by
consistency; by the score it is worst: (what arrived of the edit) x sqrt(agreement of views x what stayed put).
"""


def write_report(columns: Sequence[Column], out: Path, pictures: int = 20) -> str:
    """Write report.md, report.json, plots and index.html into `out`; returns the main table and times."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be created ({error.strerror}); give --out another folder.") from None
    text = markdown(columns)
    with atomic_write(out / "report.md") as partial:
        partial.write_text(text, encoding="utf-8")
    with atomic_write(out / "report.json") as partial:
        content = {**summary_of(columns), "timing": {column.label: timing(column) for column in columns}}
        partial.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    plots = write_plots(columns, out)
    write_page(columns, out / "index.html", text, plots, pictures)
    return f"{tables.main_table(columns)}\n{tables.time_table(columns)}"


def markdown(columns: Sequence[Column]) -> str:
    """The report's text."""
    run = columns[0].run
    parts = [
        f"# {run['manifest'] or 'Benchmark'}",
        f"Manifest {run['manifest_sha256'][:12]}, {len(columns[0].results)} edits of "
        f"{len({r.scene for r in columns[0].results.values()})} scenes.",
        tables.notes_list(columns),
        EXPLANATION,
        "## Main comparison",
        tables.main_table(columns),
    ]
    if len(columns) > 1:
        parts += [f"## {columns[0].label} against the others, edit by edit", tables.differences_table(columns)]
    by_type = [name for name in ("score", "psnr-in-edit") if name in metric_names(columns)]
    parts += ["## By type of edit", *(tables.types_table(columns, name) for name in by_type)]
    parts += ["## Time", "Seconds for one edit of a scene, all views.", tables.time_table(columns)]
    parts += ["## Failures", tables.failures_list(columns)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def summary_of(columns: Sequence[Column]) -> dict[str, Any]:
    """All means as JSON data: a function of manifest and methods alone, so the same on every run. No times."""
    return {
        "manifest_sha256": columns[0].run["manifest_sha256"],
        "items": sorted(columns[0].results),
        "methods": {column.label: _of_column(column, metric_names(columns)) for column in columns},
    }


def _of_column(column: Column, names: Sequence[str]) -> dict[str, Any]:
    means = {name: mean_of(column, name) for name in names}
    return {
        "method": column.run["method"],
        "failures": {result.id: result.failure for result in column.failures},
        "metrics": {name: None if mean is None else asdict(mean) for name, mean in means.items()},
    }
