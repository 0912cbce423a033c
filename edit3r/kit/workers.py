"""One resumable runner for any list of jobs: in this process, in several processes, or on a Ray
cluster.

A job is a key with something that can be pickled; a function turns it into a row of JSON data. Each
row is one line of a file and is on disk before the next row is taken: a run that was killed at any
moment goes on where it stopped.
"""

import json
import math
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, Literal

from pydantic_core import to_json

from edit3r.contract.errors import InputError, MissingDependencyError, RunError
from edit3r.kit.children import SAFE_PATH, restore_path, safe_path
from edit3r.kit.files.atomic import atomic_write

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
Function = Callable[[Any], Row]
KeyedJob = tuple[str, Any]
KeyedRow = tuple[str, Row]


@dataclass(frozen=True)
class Workers:
    """Who does the jobs. The rows are the same for any number of workers."""

    count: int = 1  # 1: this process does them itself, unless they are spread with Ray
    spread: Literal["processes", "ray"] = "processes"
    threads: int | None = (
        None  # of torch in each worker, which decide the order of sums; None: as they are
    )
    # a worker that dies leaves its job a failure, and another takes its place; else all ends
    may_die: bool = False


@dataclass(frozen=True)
class Progress:
    """What `on_done` is told after each job."""

    key: str
    row: Row
    done: int  # how many have a row now, those of earlier runs included
    total: int
    seconds_left: float

    def said(self, what: str, of: str = "") -> str:
        """One line about the job, in front what it is `of`, with what came of it and the time
        left.
        """
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
    workers: Workers = Workers(),
    key_name: str = "key",
    seconds: float | None = None,
    on_done: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, dict[str, Any]]:
    """Do the jobs that have no row in `path` yet, and return the rows of all of them by key, in the
    order of `jobs`.

    A row is `{key_name: key, **function(jobs[key])}`. NaN and infinity become null (None), at once
    and when read back. `function` is pickled to each worker once, so an object may keep what it
    built at its first call. An error ends the run and keeps the rows made so far. So does the death
    of a worker, which a job can cause that takes all memory; with `Workers.may_die` it becomes the
    row `{"failure": sentence}`. A single worker starts no job after `seconds` of wall time; jobs
    that did not start are missing in the answer. At the end the file holds these rows in order,
    then rows of other keys, however the work was spread and interrupted.
    """
    repair(path)
    found = read_rows(path, key_name)
    left = {key: job for key, job in jobs.items() if key not in found}
    already, start = len(jobs) - len(left), time.monotonic()
    end = math.inf if seconds is None else start + seconds
    todo = takewhile(lambda _: time.monotonic() <= end, left.items())
    with closing(_spread(_Task(function, workers.threads), todo, workers)) as rows:
        for count, (key, row) in enumerate(rows, start=1):
            found[key] = append_row(path, {key_name: key, **row})
            rate = (time.monotonic() - start) / count
            on_done(
                Progress(
                    key,
                    found[key],
                    already + count,
                    len(jobs),
                    rate * (len(left) - count),
                )
            )
    ordered = {key: found[key] for key in jobs if key in found}
    if found:
        write_rows(path, {**ordered, **found}.values())
    return ordered


def append_row(path: Path, row: Row) -> dict[str, Any]:
    """Add one line, have it on disk before returning, and return the row as it will be read
    back.
    """
    line = _line(row)
    with path.open("a", encoding="utf-8") as file:
        file.write(line)
        file.flush()
        os.fsync(file.fileno())
    return json.loads(line)


def read_rows(path: Path, key_name: str = "key") -> dict[str, dict[str, Any]]:
    """Return rows by key, without a last line that a kill cut off. Raises InputError for another
    bad line.
    """
    if not path.is_file():
        return {}
    found = {}
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    for number, line in enumerate(lines[:-1], start=1):
        try:
            row = json.loads(line)
            found[row[key_name]] = row
        except (ValueError, TypeError, KeyError):
            raise InputError(
                f"{path}, line {number}: not a result; delete the line to measure it anew."
            ) from None
    return found


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
    """Return the row as a line of JSON, with null in the place of every number that JSON does not
    have.
    """
    return (
        json.dumps(json.loads(to_json(row, inf_nan_mode="null")), ensure_ascii=False)
        + "\n"
    )


@dataclass(frozen=True)
class _Task:
    """What a worker does with every job; picklable when its function is."""

    function: Function
    threads: int | None

    def do(self, job: KeyedJob) -> KeyedRow:
        """Return the job's key and its row."""
        if self.threads is not None:
            import torch

            torch.set_num_threads(self.threads)
        return job[0], self.function(job[1])


def _spread(
    task: _Task, jobs: Iterator[KeyedJob], workers: Workers
) -> Generator[KeyedRow, None, None]:
    """Yield keys and rows in any order, each worker with one job at a time."""
    if workers.spread == "processes" and workers.count == 1 and not workers.may_die:
        yield from map(task.do, jobs)
        return
    crew = (_OnRay if workers.spread == "ray" else _InProcesses)(task, workers)
    idle: list[Any] = []
    busy: dict[Any, tuple[Any, str]] = {}
    try:
        while True:
            for job in islice(jobs, workers.count - len(busy)):
                worker = idle.pop() if idle else crew.start()
                busy[crew.give(worker, job)] = worker, job[0]
            if not busy:
                return
            ticket = crew.first(list(busy))
            worker, key = busy.pop(ticket)
            try:
                row = crew.answer(ticket)
                idle.append(worker)
            except _WorkerDied as error:
                if not workers.may_die:
                    raise RunError(f"{error} What is done is kept.") from None
                row = key, {"failure": str(error)}
            yield row
    finally:
        crew.end()


class _WorkerDied(Exception):
    """A worker ended in the middle of a job."""

    def __str__(self) -> str:
        return (
            "the worker process died: out of memory, or a crash inside a library; run "
            "again, with fewer --workers."
        )


class _InProcesses:
    """Workers as new processes of this machine; forking one that has used torch's threads can
    hang.
    """

    def __init__(self, task: _Task, workers: Workers) -> None:
        self._task = task
        self._pools: list[ProcessPoolExecutor] = []

    def start(self) -> ProcessPoolExecutor:
        """A pool of one, so that it is known which job a process died of."""
        context = multiprocessing.get_context("spawn")
        arguments = (self._task, os.environ.get(SAFE_PATH))
        with safe_path():  # its locks already start a process that watches them
            pool = ProcessPoolExecutor(
                1, context, initializer=_begin_worker, initargs=arguments
            )
        self._pools.append(pool)
        return pool

    def give(self, pool: ProcessPoolExecutor, job: KeyedJob) -> Future:
        with safe_path():  # the first job starts the worker's process
            return pool.submit(_call_task, job)

    def first(self, futures: list[Future]) -> Future:
        return next(as_completed(futures))

    def answer(self, future: Future) -> KeyedRow:
        """Return what became of the job; raises what the job raised, and _WorkerDied."""
        try:
            return future.result()
        except BrokenProcessPool:
            raise _WorkerDied from None

    def end(self) -> None:
        for pool in self._pools:
            pool.shutdown(wait=True, cancel_futures=True)


_task: _Task | None = (
    None  # of this worker process; set once, so that what its function has built stays
)


def _begin_worker(task: _Task, path: str | None) -> None:
    global _task
    _task = task
    restore_path(path)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when the one that started it was killed, so that nobody does a job twice."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def _call_task(job: KeyedJob) -> KeyedRow:
    assert _task is not None  # set as the process began
    return _task.do(job)


class _OnRay:
    """Workers as actors of the Ray cluster that RAY_ADDRESS names, else one here; all nodes must
    see the same paths.
    """

    def __init__(self, task: _Task, workers: Workers) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError:
            raise MissingDependencyError(
                '--ray needs Ray; install with: pip install "edit3r[ray]"'
            ) from None
        self._ray, self._task, cores = ray, task, workers.threads or 1
        self._started = not ray.is_initialized()
        if self._started:
            here = {"num_cpus": workers.count * cores, "include_dashboard": False}
            ray.init(
                log_to_driver=False,
                logging_level="ERROR",
                **({} if os.environ.get("RAY_ADDRESS") else here),
            )
        self._actor = ray.remote(num_cpus=cores)(_Task)

    def start(self) -> Any:
        return self._actor.remote(self._task.function, self._task.threads)

    def give(self, worker: Any, job: KeyedJob) -> Any:
        return worker.do.remote(job)

    def first(self, tickets: list[Any]) -> Any:
        return self._ray.wait(tickets, num_returns=1)[0][0]

    def answer(self, ticket: Any) -> KeyedRow:
        """Return what became of the job; raises what the job raised, and _WorkerDied."""
        exceptions = self._ray.exceptions
        try:
            return self._ray.get(ticket)
        except exceptions.RayTaskError as error:
            raise error.cause from None
        except exceptions.RayError:
            raise _WorkerDied from None

    def end(self) -> None:
        if self._started:
            self._ray.shutdown()
