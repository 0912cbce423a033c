"""Results on disk: one JSON line an item, written when it is whole; a kill costs no more than the items under way."""

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write

__all__ = ["RESULTS", "RUN", "ItemResult", "append_result", "read_results", "repair", "rewrite_results"]

RESULTS = "results.jsonl"
RUN = "bench-run.json"


@dataclass(frozen=True)
class ItemResult:
    """What one edit gave."""

    id: str
    scene: str
    type: str
    metrics: Mapping[str, float]  # NaN where one means nothing
    failure: str = ""  # why the method gave nothing; "" when it did
    timing: Mapping[str, Any] | None = None  # `edit3r_measure.evaluation.stopwatch.Timing`; None after a failure
    facts: Mapping[str, Any] = field(default_factory=dict)


def append_result(folder: Path, result: ItemResult) -> None:
    """Add one line and have it on disk before returning."""
    with (folder / RESULTS).open("a", encoding="utf-8") as file:
        file.write(_line(result))
        file.flush()
        os.fsync(file.fileno())


def read_results(folder: Path) -> dict[str, ItemResult]:
    """Results by item id; a last line that was cut off by a kill counts as never written."""
    path = folder / RESULTS
    if not path.is_file():
        return {}
    found = {}
    lines = path.read_text(encoding="utf-8").split("\n")
    for number, line in enumerate(lines[:-1], start=1):
        try:
            result = _from_line(line)
        except (ValueError, TypeError, AttributeError):
            raise InputError(
                f"{path}, line {number}: not a result; delete the line to measure its item anew."
            ) from None
        found[result.id] = result
    return found


def repair(folder: Path) -> None:
    """Cut a half-written last line off, so that the next one starts on its own."""
    path = folder / RESULTS
    if path.is_file():
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            with atomic_write(path) as partial:
                partial.write_bytes(whole)


def rewrite_results(folder: Path, results: Iterable[ItemResult]) -> None:
    """All results at once, in the given order: the same file however the work was spread and interrupted."""
    with atomic_write(folder / RESULTS) as partial:
        partial.write_text("".join(map(_line, results)), encoding="utf-8")


def _line(result: ItemResult) -> str:
    content = asdict(result)
    content["metrics"] = {k: v if math.isfinite(v) else None for k, v in result.metrics.items()}
    return json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n"


def _from_line(line: str) -> ItemResult:
    content = json.loads(line)
    content["metrics"] = {k: float("nan") if v is None else v for k, v in content["metrics"].items()}
    return ItemResult(**content)
