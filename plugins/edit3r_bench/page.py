"""The page of a benchmark's report: its text, and the sheets of some edits."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

from markdown_it import MarkdownIt

from edit3r.kit.command.results import write_text

HEAD = """\
<!doctype html><html lang="en"><meta charset="utf-8"><style>
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 1500px; padding: 0 1rem;
  color: #1c1c1e; background: #faf9f7 }
table { border-collapse: collapse; font-size: 13px; display: block; overflow-x: auto }
td, th { padding: .25rem .7rem; border-bottom: 1px solid #dedbd5; text-align: right }
td:first-child, th:first-child { text-align: left } img { max-width: 100% }
</style>
"""


def write_page(
    path: Path, text: str, folders: Mapping[str, Path], edits: Sequence[str]
) -> None:
    """Write the report `text` (Markdown) and the sheets of these edits by all methods; `folders`
    are those of the methods' results by label.
    """
    parts = [text, "## Images"]
    for edit in edits:
        parts.append(f"### {edit}")
        for label, folder in folders.items():
            sheet = folder / "pictures" / f"{edit}.webp"
            if sheet.is_file():
                content = base64.b64encode(sheet.read_bytes()).decode("ascii")
                parts.append(f"{label}\n\n![](data:image/webp;base64,{content})")
    page = MarkdownIt("commonmark", {"html": False}).enable("table")
    write_text(path, HEAD + page.render("\n\n".join(parts)))
