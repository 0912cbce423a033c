"""What all reports share: Markdown tables and the machine that was measured on."""

import os
import platform
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from edit3r.io.run_folder import installed_versions


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """Return a Markdown table whose first `left` columns are set left and the others right, without a last newline."""
    ruler = ["---"] * left + ["--:"] * (len(titles) - left)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (titles, ruler, *rows))


def format_or_dash(value: float | None, form: str) -> str:
    """Return a number as `form` says, "-" for None."""
    return "-" if value is None else format(value, form)


def describe_machine(threads: int | None) -> dict[str, Any]:
    """Return processor, cores, threads and versions as JSON data, as far as they can be told."""
    versions = installed_versions()
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": threads or "as the libraries choose",
        "versions": {name: versions[name] for name in ("edit3r", "python", "torch", "numba") if name in versions},
    }


def _processor() -> str:
    table = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.+)", table.read_text()) if table.is_file() else None
    return found[1] if found else platform.processor() or platform.machine()
