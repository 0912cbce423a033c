"""One HTML file that opens from disk: the tables, the plots, and every method's pictures side by side."""

import base64
import html
import io
import re
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from edit3r.io.atomic import atomic_write
from edit3r_measure.bench.summary import Column, value_of

__all__ = ["write_page"]

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


def write_page(columns: Sequence[Column], path: Path, text: str, plots: Sequence[Path], pictures: int) -> None:
    """Write the page; `text` is the report in Markdown, `pictures` how many edits are shown at most."""
    shown = _spread(sorted(columns[0].results), pictures)
    parts = [_from_markdown(text), *(plot.read_text(encoding="utf-8").partition("<svg")[2] for plot in plots)]
    parts[1:] = [f"<svg{part}" for part in parts[1:]]
    parts.append(
        f"<h2>Pictures</h2><p>{len(shown)} of {len(columns[0].results)} edits, evenly chosen. Frames from left to "
        "right: the inputs (the first is the reference), then the held-back views.</p>"
    )
    parts += [_item(columns, name) for name in shown]
    title = html.escape(columns[0].run["manifest"] or "edit3r benchmark")
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
        f"<body>{''.join(parts)}</body></html>\n"
    )
    with atomic_write(path) as partial:
        partial.write_text(page, encoding="utf-8")


def _item(columns: Sequence[Column], name: str) -> str:
    """Photos and truth once, then each method's 2D edit where it differs, and what it shows."""
    rows = []
    folders = [column.folder / "pictures" / name for column in columns]
    for label, file in (("photos", "photos"), ("truth", "truth")):
        found = next((folder / f"{file}.png" for folder in folders if (folder / f"{file}.png").is_file()), None)
        if found is not None:
            rows.append(f"<span>{label}</span>{_image(found)}")
    edits: dict[bytes, list[str]] = {}
    for column, folder in zip(columns, folders):
        if (folder / "edited.png").is_file():
            edits.setdefault((folder / "edited.png").read_bytes(), []).append(column.label)
    for content, labels in edits.items():
        rows.append(f"<span>2D edit: {html.escape(', '.join(labels))}</span>{_image(content)}")
    for column, folder in zip(columns, folders):
        result, label = column.results[name], html.escape(column.label)
        if result.failure:
            rows.append(f'<span>{label}</span><span class="failed">failed: {html.escape(result.failure)}</span>')
        elif (folder / "shown.png").is_file():
            rows.append(f"<span>{label}, score {value_of(result, 'score'):.2f}</span>{_image(folder / 'shown.png')}")
    kind = columns[0].results[name].type
    return f'<div class="item"><h3>{html.escape(name)} ({kind})</h3><div class="strips">{"".join(rows)}</div></div>'


def _image(source: Path | bytes) -> str:
    """An embedded WebP."""
    picture = Image.open(io.BytesIO(source) if isinstance(source, bytes) else source).convert("RGB")
    if picture.height > HEIGHT:
        picture = picture.resize((round(picture.width * HEIGHT / picture.height), HEIGHT), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    picture.save(buffer, "WEBP", quality=88)
    return f'<img alt="" src="data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode("ascii")}">'


def _spread(names: Sequence[str], count: int) -> list[str]:
    """At most `count` of `names`, evenly."""
    if count >= len(names):
        return list(names)
    return [names[int((place + 0.5) * len(names) / count)] for place in range(count)]


def _from_markdown(text: str) -> str:
    """The report's own Markdown: headings, lists, tables, paragraphs, code and bold."""
    blocks = [_block(block) for block in re.split(r"\n{2,}", text.strip())]
    return "\n".join(blocks)


def _block(block: str) -> str:
    lines = block.split("\n")
    if heading := re.match(r"(#+) (.*)", block):
        level = len(heading.group(1))
        return f"<h{level}>{_inline(heading.group(2))}</h{level}>"
    if block.startswith("|"):
        cells = [[_inline(cell.strip()) for cell in line.strip("|").split("|")] for line in lines]
        head = "".join(f"<th>{cell}</th>" for cell in cells[0])
        body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in cells[2:])
        return f"<table><tr>{head}</tr>{body}</table>"
    if block.startswith("- "):
        return "<ul>" + "".join(f"<li>{_inline(line[2:])}</li>" for line in lines) + "</ul>"
    return f"<p>{_inline(block)}</p>"


def _inline(text: str) -> str:
    text = re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text))
    return re.sub(r"\*\*([^*]*)\*\*", r"<b>\1</b>", text)
