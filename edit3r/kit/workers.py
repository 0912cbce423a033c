"""One resumable runner for any list of jobs: here, in several processes, or on Ray.

A job is a key with something that can be pickled; a function turns it into a row of JSON data. Each
row is one line of a file and is on disk before the next row is taken: a run that was killed at any
moment goes on where it stopped.
"""

import json
import os
import time
from collections.abc import Callable, Hashable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_core import to_json

from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.text import parse_json
from edit3r.kit.worker_pool import (
    ONE_HERE,
    Function,
    Task,
    Workers,
    spread,
)

__all__ = [
    "Progress",
    "Workers",
    "append_row",
    "read_rows",
    "repair",
    "run_resumable",
    "write_rows",
]

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Progress:
    """What `on_done` is told after each job."""

    key: str
    row: Row
    done: int  # how many have a row now, those of earlier runs included
    total: int
    seconds_left: float

    def line(self, what: str, of: str = "") -> str:
        """One line about the job, with what it is `of`, what came of it and the time left."""
        left = self.seconds_left
        size, unit = (
            (1, "s") if left < 120 else (60, "min") if left < 7200 else (3600, "h")
        )
        return (
            f"  [{self.done}/{self.total}] {of}{self.key}: {what}; about "
            f"{left / size:.0f} {unit} left"
        )


def run_resumable(
    jobs: Mapping[str, Any],
    function: Function,
    path: Path,
    *,
    workers: Workers = ONE_HERE,
    key_name: str = "key",
    group: Callable[[Any], Hashable] = lambda job: None,
    on_done: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, dict[str, Any]]:
    """Do the jobs that have no row in `path` yet; returns the rows of all, in their order.

    A row is `{key_name: key, **function(jobs[key])}`. NaN and infinity become null (None), at once
    and when read back. `function` is pickled to each worker once, so an object may keep what it
    built at its first call; several workers take jobs of one `group` one after the other where they
    can. An error ends the run and keeps the rows made so far. So does the death of a worker, which
    a job can cause that takes all memory; with `Workers.may_die` it becomes the row `{"failure":
    sentence}`. On Ray, another worker tries once more before that. At the end the file holds these
    rows in order, then rows of other keys, however the work was spread and interrupted.
    """
    repair(path)
    rows_by_key = read_rows(path, key_name)
    left = {key: job for key, job in jobs.items() if key not in rows_by_key}
    already, start = len(jobs) - len(left), time.monotonic()
    task = Task(function, workers.threads)
    alone = workers.spread == "processes" and workers.count == 1 and not workers.may_die
    todo = left.items()
    one_by_one = (task.do(job) for job in todo)
    with closing(one_by_one if alone else spread(task, todo, workers, group)) as rows:
        for count, (key, row) in enumerate(rows, start=1):
            rows_by_key[key] = append_row(path, {key_name: key, **row})
            rate = (time.monotonic() - start) / count
            on_done(
                Progress(
                    key,
                    rows_by_key[key],
                    already + count,
                    len(jobs),
                    rate * (len(left) - count),
                )
            )
    ordered = {key: rows_by_key[key] for key in jobs}
    if rows_by_key:
        write_rows(path, {**ordered, **rows_by_key}.values())
    return ordered


def append_row(path: Path, row: Row) -> dict[str, Any]:
    """Add one line, have it on disk, and return the row as it will be read back."""
    line = _line(row)
    with path.open("a", encoding="utf-8") as file:
        file.write(line)
        file.flush()
        os.fsync(file.fileno())
    return json.loads(line)


def read_rows(
    path: Path, key_name: str = "key", read: Callable[[dict[str, Any]], Any] = dict
) -> dict[str, Any]:
    """Return rows by key, without a last line that a kill cut off. Raises InputError for another
    bad line, and for one that `read`, which makes of it what is returned, has an error with.
    """
    if not path.is_file():
        return {}
    rows = {}
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    for number, line in enumerate(lines[:-1], start=1):
        try:
            row = parse_json(line)
            rows[row[key_name]] = read(row)
        except (ValueError, TypeError, KeyError, AttributeError):
            raise InputError(
                f"{path}, line {number}: not a result; delete the line to run that job again."
            ) from None
    return rows


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Replace the file by these rows."""
    with atomic_write(path) as partial:
        partial.write_text("".join(map(_line, rows)), encoding="utf-8")


def repair(path: Path) -> None:
    """Cut a half-written last line off, so that the next one starts on its own."""
    content = path.read_bytes() if path.is_file() else b""
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content:
        with atomic_write(path) as partial:
            partial.write_bytes(whole)


def _line(row: Row) -> str:
    """The row as a line of JSON, with null for every number that JSON does not have."""
    return (
        json.dumps(json.loads(to_json(row, inf_nan_mode="null")), ensure_ascii=False)
        + "\n"
    )
