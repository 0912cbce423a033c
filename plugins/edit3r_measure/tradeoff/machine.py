"""What a measurement was made on, as far as it can be told."""

import os
import platform
import re
from pathlib import Path
from typing import Any

from edit3r.io.run_folder import installed_versions


def describe_machine(threads: int | None) -> dict[str, Any]:
    """Processor, cores, threads and versions, as JSON data."""
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
