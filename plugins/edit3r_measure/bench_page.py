"""The report as one HTML file that opens from disk: the text, the plots, and every method's images side by side."""

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt
from PIL import Image

from edit3r.io.atomic import atomic_write
from edit3r.io.decode import FORMATS

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
HEIGHT = 128
"""Strips are reduced to this height [pixels]."""


@dataclass(frozen=True)
class MethodStrips:
    """What one method left of one edit."""

    label: str
    folder: Path  # of its strips: photos.png, edited.png, shown.png, truth.png
    score: float
    failure: str  # "" when it did not fail


@dataclass(frozen=True)
class PageEdit:
    """One edit by all methods, in the order of the columns."""

    title: str
    methods: Sequence[MethodStrips]


def write_page(path: Path, text: str, plots: Sequence[Path], edits: Sequence[PageEdit], most: int) -> None:
    """Write the report `text` (Markdown), the SVG `plots`, and at most `most` of the `edits`, spread evenly."""
    shown = edits
    if most < len(edits):
        shown = [edits[int((place + 0.5) * len(edits) / most)] for place in range(most)]
    parts = [MarkdownIt("commonmark", {"html": False}).enable("table").render(text)]
    parts += ["<svg" + plot.read_text(encoding="utf-8").partition("<svg")[2] for plot in plots]
    parts.append(
        f"<h2>Pictures</h2><p>{len(shown)} of {len(edits)} edits, evenly chosen. Frames from left to right: the inputs "
        "(the first is the reference), then the held-back views.</p>"
    )
    for edit in shown:
        title = f"<h3>{html.escape(edit.title)}</h3>"
        parts.append(f'<div class="item">{title}<div class="strips">{_strips(edit.methods)}</div></div>')
    title = html.escape(text.partition("\n")[0].removeprefix("# "))
    with atomic_write(path) as partial:
        partial.write_text(
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
            f"<body>{''.join(parts)}</body></html>\n",
            encoding="utf-8",
        )


def _strips(methods: Sequence[MethodStrips]) -> str:
    """Return photos and truth once, then each 2D edit with the methods that had it, then what each method shows."""
    rows = []
    for kind in ("photos", "truth"):
        files = [file for method in methods if (file := method.folder / f"{kind}.png").is_file()]
        rows += [f"<span>{kind}</span>{_embed(file.read_bytes())}" for file in files[:1]]
    edits: dict[bytes, list[str]] = {}
    for method in methods:
        if (method.folder / "edited.png").is_file():
            edits.setdefault((method.folder / "edited.png").read_bytes(), []).append(method.label)
    rows += [f"<span>2D edit: {html.escape(', '.join(who))}</span>{_embed(image)}" for image, who in edits.items()]
    for method in methods:
        label, file = html.escape(method.label), method.folder / "shown.png"
        if method.failure:
            rows.append(f'<span>{label}</span><span class="failed">failed: {html.escape(method.failure)}</span>')
        elif file.is_file():
            rows.append(f"<span>{label}, score {method.score:.2f}</span>{_embed(file.read_bytes())}")
    return "".join(rows)


def _embed(content: bytes) -> str:
    """Return an image file's content as an `img` tag that holds it as WebP."""
    image = Image.open(io.BytesIO(content), formats=FORMATS).convert("RGB")
    if image.height > HEIGHT:
        image = image.resize((round(image.width * HEIGHT / image.height), HEIGHT), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", quality=88)
    return f'<img alt="" src="data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode("ascii")}">'
