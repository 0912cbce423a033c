"""What came of all jobs: a table of verdicts, on the terminal and as files."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edit3r.io.atomic import atomic_write
from edit3r.verdict import LABELS

Rows = Mapping[str, Mapping[str, Any]]
NO_RESULT = "no result"
TITLES = ("job", "verdict", "input views [dB]", "Gaussians", "why")


def verdict_of(row: Mapping[str, Any]) -> str:
    return NO_RESULT if "failure" in row else row["verdict"]


def counted(rows: Rows) -> str:
    """How many jobs got each verdict, such as '40 jobs: 31 good, 8 fair, 1 no result'."""
    counts = Counter(map(verdict_of, rows.values()))
    return f"{len(rows)} jobs: " + ", ".join(
        f"{counts[label]} {label}" for label in (*LABELS, NO_RESULT) if counts[label]
    )


def table(rows: Rows, most: int | None = None) -> str:
    """A Markdown table with a line for each job; of more than `most` jobs, those that came out worst."""
    rank = [NO_RESULT, *reversed(LABELS)]
    chosen = (
        sorted(rows, key=lambda id: rank.index(verdict_of(rows[id])))[:most]
        if len(rows) > (most or len(rows))
        else rows
    )
    lines = [f"| {' | '.join(cells)} |" for cells in (TITLES, ("---",) * len(TITLES))]
    return "\n".join([*lines, *(f"| {' | '.join(_cells(id, rows[id]))} |" for id in chosen)])


def _cells(id: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    if "failure" in row:
        return id, NO_RESULT, "", "", row["failure"].replace("|", "\\|")
    return id, row["verdict"], f"{row['psnr']:.1f}", f"{row['gaussians']:,}", row["reason"].replace("|", "\\|")


def write_summary(out: Path, rows: Rows) -> None:
    """Write `summary.json` (counts, and the rows with their folders) and `summary.md` (the table)."""
    counts = dict(Counter(map(verdict_of, rows.values())))
    content = {"jobs": len(rows), "verdicts": counts, "rows": list(rows.values())}
    for name, text in (
        ("summary.json", json.dumps(content, indent=1, ensure_ascii=False)),
        ("summary.md", f"# {counted(rows)}\n\n{table(rows)}"),
    ):
        with atomic_write(out / name) as partial:
            partial.write_text(text + "\n", encoding="utf-8")
