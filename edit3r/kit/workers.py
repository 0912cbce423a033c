"""One resumable runner for any list of jobs: here, in several processes, or on Ray.

A job is a key with something that can be pickled; a function turns it into a row of JSON data. Each
row is one line of a file and is on disk before the next row is taken: a run that was killed at any
moment goes on where it stopped.
"""

import json
import os
import time
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic_core import to_json

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.text import parse_json
from edit3r.kit.worker_pool import (
    ONE_HERE,
    Function,
    KeyedJob,
    KeyedRow,
    Task,
    WorkerDied,
    WorkerPool,
    Workers,
    pool_of,
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
MOST_AHEAD = 1000
"""Jobs that are looked through for one of the group that a worker did last."""
MOST_STARTS = 5
"""Workers in a row that may die before they are ready."""


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
    here = (task.do(job) for job in todo)
    with closing(here if alone else _spread(task, todo, workers, group)) as rows:
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
                f"{path}, line {number}: not a result; delete the line to measure it anew."
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


def _spread(
    task: Task,
    jobs: Iterable[KeyedJob],
    workers: Workers,
    group: Callable[[Any], Hashable],
) -> Generator[KeyedRow, None, None]:
    """Yield keys and rows in any order, each worker with one job at a time."""
    pool = pool_of(task, workers)
    shift = _Shift(pool, jobs, workers, group)
    try:
        while shift.hand_out():
            if row := shift.next_row():
                yield row
    finally:
        pool.end()


@dataclass(eq=False)
class _Hand:
    """A worker, and the group of its last job."""

    worker: Any
    group: Hashable = None


class _Shift:
    """Which worker does which job."""

    def __init__(
        self,
        pool: WorkerPool,
        jobs: Iterable[KeyedJob],
        workers: Workers,
        group: Callable[[Any], Hashable],
    ) -> None:
        self._pool, self._workers, self._group = pool, workers, group
        self._todo = deque(jobs)
        self._deaths: dict[str, int] = {}  # by key of a job
        self._idle: list[_Hand] = []
        self._starting: dict[Any, _Hand] = {}  # by ticket
        self._busy: dict[Any, tuple[_Hand, KeyedJob]] = {}  # by ticket
        self._failed_starts = 0

    def hand_out(self) -> bool:
        """Start workers, and give a job to each that is ready; False: all is done."""
        wanted = min(self._workers.count, len(self._todo) + len(self._busy))
        present = len(self._idle) + len(self._starting) + len(self._busy)
        for _ in range(wanted - present):
            worker, ticket = self._pool.start()
            if ticket is None:
                self._idle.append(_Hand(worker))
            else:
                self._starting[ticket] = _Hand(worker)
        while self._idle and self._todo:
            hand = self._idle.pop()
            job = self._job_for(hand)
            self._busy[self._pool.give(hand.worker, job)] = hand, job
        return bool(self._busy or self._todo)

    def next_row(self) -> KeyedRow | None:
        """Wait until something happens; a row, where that was a finished job."""
        any_ready = bool(self._busy or self._idle)
        ticket = self._pool.first([*self._busy, *self._starting], any_ready)
        if ticket in self._starting:
            self._arrived(ticket)
            return None
        hand, job = self._busy.pop(ticket)
        try:
            row = self._pool.answer(ticket)
        except WorkerDied as error:
            return self._died(job, error)
        self._idle.append(hand)
        return row

    def _job_for(self, hand: _Hand) -> KeyedJob:
        """The next job, or one soon after it that needs what this worker has loaded."""
        ahead = range(min(len(self._todo), MOST_AHEAD))
        same = (k for k in ahead if self._group(self._todo[k][1]) == hand.group)
        number = next(same, 0)
        job = self._todo[number]
        del self._todo[number]
        hand.group = self._group(job[1])
        return job

    def _arrived(self, ticket: Any) -> None:
        hand = self._starting.pop(ticket)
        try:
            self._pool.answer(ticket)
        except WorkerDied:
            self._failed_starts += 1
            if self._failed_starts == MOST_STARTS:
                raise RunError(
                    f"{MOST_STARTS} workers died one after the other before their first job; is "
                    "edit3r installed on all nodes? What is done is kept."
                ) from None
            return
        self._failed_starts = 0
        self._idle.append(hand)

    def _died(self, job: KeyedJob, error: WorkerDied) -> KeyedRow | None:
        """What becomes of a job whose worker died: another try, a failure, or the end of all."""
        key = job[0]
        self._deaths[key] = self._deaths.get(key, 0) + 1
        if self._deaths[key] < self._pool.tries:
            self._todo.appendleft(job)
            return None
        if not self._workers.may_die:
            raise RunError(f"{error} What is done is kept.") from None
        return key, {"failure": str(error)}
