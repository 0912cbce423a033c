"""A benchmark's report on disk: text, numbers, and one HTML page with every method's images side by side."""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

from markdown_it import MarkdownIt
from PIL import Image

from edit3r.io.decode import FORMATS
from edit3r.io.images import evenly
from edit3r_measure import bench_report
from edit3r_measure.bench_report import Column, timing
from edit3r_measure.report import make_folder, write_json, write_text

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


def write_report(columns: Sequence[Column], out: Path, edits_shown: int = 20) -> str:
    """Write report.md, report.json and index.html into `out`, and return the main table and the times."""
    make_folder(out)
    text = bench_report.report_text(columns)
    write_text(out / "report.md", text)
    times = {column.label: timing(column) for column in columns}
    write_json(out / "report.json", {**bench_report.summary_of(columns), "timing": times})
    write_page(out / "index.html", text, columns, edits_shown)
    return f"{bench_report.main_table(columns)}\n\n{bench_report.time_table(columns)}\n"


def write_page(path: Path, text: str, columns: Sequence[Column], most: int) -> None:
    """Write the report `text` (Markdown), and images of at most `most` edits, spread evenly."""
    edits = list(columns[0].results.values()) if columns else []
    shown = evenly(edits, most)
    parts = [MarkdownIt("commonmark", {"html": False}).enable("table").render(text)]
    parts.append(
        f"<h2>Pictures</h2><p>{len(shown)} of {len(edits)} edits, evenly chosen. Frames from left to right: the inputs "
        "(the first is the reference), then the held-back views.</p>"
    )
    for edit in shown:
        title = f"<h3>{html.escape(f'{edit.id} ({edit.type})')}</h3>"
        parts.append(f'<div class="item">{title}<div class="strips">{_strips(columns, edit.id)}</div></div>')
    title = html.escape(text.partition("\n")[0].removeprefix("# "))
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    write_text(path, f"{head}<body>{''.join(parts)}</body></html>\n")


def _strips(columns: Sequence[Column], edit: str) -> str:
    """Return photos and truth once, then each 2D edit with the methods that had it, then what each method shows."""
    folders = {column.label: column.folder / "pictures" / edit for column in columns}
    rows = []
    for kind in ("photos", "truth"):
        files = [file for folder in folders.values() if (file := folder / f"{kind}.png").is_file()]
        rows += [f"<span>{kind}</span>{_embed(file.read_bytes())}" for file in files[:1]]
    edits: dict[bytes, list[str]] = {}
    for label, folder in folders.items():
        if (folder / "edited.png").is_file():
            edits.setdefault((folder / "edited.png").read_bytes(), []).append(label)
    rows += [f"<span>2D edit: {html.escape(', '.join(who))}</span>{_embed(image)}" for image, who in edits.items()]
    for column in columns:
        result, file = column.results[edit], folders[column.label] / "shown.png"
        label, failure = html.escape(column.label), html.escape(result.failure)
        if failure:
            rows.append(f'<span>{label}</span><span class="failed">failed: {failure}</span>')
        elif file.is_file():
            rows.append(f"<span>{label}, score {result.metrics['score']:.2f}</span>{_embed(file.read_bytes())}")
    return "".join(rows)


def _embed(content: bytes) -> str:
    """Return an image file's content as an `img` tag that holds it as WebP."""
    image = Image.open(io.BytesIO(content), formats=FORMATS).convert("RGB")
    if image.height > HEIGHT:
        image = image.resize((round(image.width * HEIGHT / image.height), HEIGHT), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=88)
    return f'<img alt="" src="data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode("ascii")}">'
