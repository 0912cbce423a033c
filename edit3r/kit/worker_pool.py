"""Who does the jobs of `edit3r.kit.workers`: processes of this machine, or actors on Ray."""

import logging
import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from edit3r.contract.errors import MissingDependencyError, RunError
from edit3r.kit.children import SAFE_PATH, restore_path, safe_path

__all__ = ()  # plugins have all they need from `edit3r.kit.workers`

Function = Callable[[Any], Mapping[str, Any]]
KeyedJob = tuple[str, Any]
KeyedRow = tuple[str, Mapping[str, Any]]

Group = Callable[[Any], Hashable]

MOST_AHEAD = 1000
"""Jobs that are looked through for one of the group that a worker did last."""
MOST_WAIT = 600
"""Seconds until a cluster that has no room for a single worker ends the run; one that grows on
demand takes minutes.
"""


@dataclass(frozen=True)
class Workers:
    """Who does the jobs. The rows are the same for any number of workers."""

    count: int = 1
    """1: this process does them itself, unless they are spread with Ray."""
    spread: Literal["processes", "ray"] = "processes"
    threads: int | None = None
    """Of torch in each worker, which decide the order of sums; None: as they are."""
    may_die: bool = False
    """A worker that dies leaves its job a failure, and another takes its place; else all ends."""
    gpus: float = 0
    """GPUs that each worker asks Ray for; a part, such as 0.25, is shared."""
    memory: int = 0
    """Bytes that each worker asks Ray for; 0: it does not ask."""


ONE_HERE = Workers()


@dataclass(frozen=True)
class Task:
    """What a worker does with every job; picklable when its function is."""

    function: Function
    threads: int | None

    def do(self, job: KeyedJob) -> KeyedRow:
        """Return the job's key and its row."""
        if self.threads is not None:
            import torch

            torch.set_num_threads(self.threads)
        return job[0], self.function(job[1])


class WorkerDied(Exception):
    """A worker ended in the middle of a job, or could not begin."""

    def __str__(self) -> str:
        return (
            "the worker process died: out of memory, or a crash inside a library; run "
            "again, with fewer --workers."
        )


def spread(
    task: Task, jobs: Iterable[KeyedJob], workers: Workers, group: Group
) -> Generator[KeyedRow, None, None]:
    """Yield keys and rows in any order, each worker with one job at a time.

    A job whose worker died is a failure where `may_die`, else it ends all, as an error does.
    """
    todo = deque(jobs)
    lock, begun, own = threading.Lock(), threading.Event(), threading.local()
    crew = OnRay(task, workers) if workers.spread == "ray" else InProcesses(task)

    def begin() -> None:
        """Begin a thread with a worker of its own, as soon as there is room for it."""
        try:
            own.worker, own.group = crew.worker(), None
        except WorkerDied:
            own.worker = None
        finally:
            begun.set()

    def do_one() -> KeyedRow:
        if own.worker is None:
            raise RunError(
                "a worker died before its first job; is edit3r installed on all nodes? Finished "
                "jobs are kept."
            )
        with lock:
            job = _next(todo, group, own.group)
        own.group = group(job[1])
        try:
            return own.worker.do(job)
        except WorkerDied as error:
            if not workers.may_die:
                raise RunError(f"{error} Finished jobs are kept.") from None
            return job[0], {"failure": str(error)}
        finally:
            if not todo:  # others may need its room
                own.worker.close()

    count = min(workers.count, len(todo))
    threads = ThreadPoolExecutor(max(1, count), initializer=begin)
    try:
        rows = [threads.submit(do_one) for _ in range(len(todo))]
        if rows and not begun.wait(MOST_WAIT):
            raise RunError(crew.no_room())
        for row in as_completed(rows):
            yield row.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        crew.close()
        threads.shutdown()


def _next(todo: deque[KeyedJob], group: Group, before: Hashable) -> KeyedJob:
    """Take the next job, or one soon after it of the group that its worker did `before`."""
    ahead = range(min(len(todo), MOST_AHEAD))
    number = next((k for k in ahead if group(todo[k][1]) == before), 0)
    job = todo[number]
    del todo[number]
    return job


class InProcesses:
    """Workers as new processes: forking one that has used torch's threads can hang."""

    def __init__(self, task: Task) -> None:
        arguments = (task, os.environ.get(SAFE_PATH))
        starting = threading.Lock()  # `safe_path` is of all threads
        self.worker = partial(_Process, arguments, starting)

    def no_room(self) -> str:
        return "no worker process could be started on this machine; free some memory."

    def close(self) -> None:
        """Each worker ends with the job that it does."""


class _Process:
    """A pool of one process, so that it is known which job a process died of; then a new one."""

    def __init__(self, arguments: tuple[Any, ...], starting: threading.Lock) -> None:
        self._arguments, self._starting = arguments, starting
        self._pool: ProcessPoolExecutor | None = None

    def do(self, job: KeyedJob) -> KeyedRow:
        with self._starting, safe_path():  # the first job starts the process
            if self._pool is None:
                context = multiprocessing.get_context("spawn")
                self._pool = ProcessPoolExecutor(
                    1, context, initializer=_begin_worker, initargs=self._arguments
                )
            row = self._pool.submit(_call_task, job)
        try:
            return row.result()
        except BrokenProcessPool:
            self._pool = None
            raise WorkerDied from None

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


# of this worker process; set once, so that what its function has built stays
_task: Task | None = None


def _begin_worker(task: Task, path: str | None) -> None:
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


class OnRay:
    """Workers as actors of the Ray cluster of RAY_ADDRESS, else one here; nodes share all paths.

    Ray itself starts one that died anew, and gives it its job once more: a node may have gone away,
    which is not the job's fault.
    """

    def __init__(self, task: Task, workers: Workers) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError:
            raise MissingDependencyError(
                '--ray needs Ray; install with: pip install "edit3r[ray]"'
            ) from None
        cores = workers.threads or 1
        self._ray, self._started = ray, not ray.is_initialized()
        if self._started:
            is_here = not os.environ.get("RAY_ADDRESS")
            ray.init(
                num_cpus=workers.count * cores if is_here else None,
                include_dashboard=False if is_here else None,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        self._asked: dict[str, Any] = {"num_cpus": cores, "num_gpus": workers.gpus}
        if workers.memory:
            self._asked["memory"] = workers.memory
        asked = {**self._asked, "max_restarts": -1, "max_task_retries": 1}
        self._actor: Any = ray.remote(**asked)(Task)
        self._arguments = ray.put(task.function), task.threads  # once for all workers
        self._workers: list[_Actor] = []

    def worker(self) -> "_Actor":
        """A new worker, as soon as the cluster has room for it."""
        worker = _Actor(self._ray, self._actor.remote(*self._arguments))
        self._workers.append(worker)
        worker.be_ready()
        return worker

    def no_room(self) -> str:
        has = {
            name: round(amount, 2)
            for name, amount in self._ray.cluster_resources().items()
            if name in ("CPU", "GPU", "memory")
        }
        return (
            f"no worker got a place on the Ray cluster in {MOST_WAIT} s: each asks for "
            f"{self._asked}, the cluster has {has}; ask for less with --threads, "
            "--gpus-per-worker or --memory-per-worker."
        )

    def close(self) -> None:
        for worker in self._workers:
            worker.close()
        if self._started:
            self._ray.shutdown()


class _Actor:
    """A worker on Ray, as its thread sees it."""

    def __init__(self, ray: Any, actor: Any) -> None:
        self._ray, self._actor = ray, actor

    def be_ready(self) -> None:
        self._answer(self._actor.__ray_ready__.remote())

    def do(self, job: KeyedJob) -> KeyedRow:
        return self._answer(self._actor.do.remote(job))

    def _answer(self, ticket: Any) -> Any:
        """What a job brought; raises what the job raised, and WorkerDied."""
        exceptions = self._ray.exceptions
        try:
            return self._ray.get(ticket)
        except exceptions.RayTaskError as error:
            raise error.cause from None
        except exceptions.RayError:
            raise WorkerDied from None

    def close(self) -> None:
        self._ray.kill(self._actor)
