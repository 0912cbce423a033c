"""Who does the jobs of `edit3r.kit.workers`: processes of this machine, or actors on Ray."""

import logging
import multiprocessing
import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Literal

from edit3r.contract.errors import MissingDependencyError, RunError
from edit3r.kit.children import SAFE_PATH, restore_path, safe_path

__all__ = ()  # plugins have all they need from `edit3r.kit.workers`

Function = Callable[[Any], Mapping[str, Any]]
KeyedJob = tuple[str, Any]
KeyedRow = tuple[str, Mapping[str, Any]]

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
    """A worker ended in the middle of a job."""

    def __str__(self) -> str:
        return (
            "the worker process died: out of memory, or a crash inside a library; run "
            "again, with fewer --workers."
        )


class InProcesses:
    """Workers as new processes: forking one that has used torch's threads can hang.

    As `OnRay`, it starts workers, gives them jobs and takes their answers, each by a ticket: what
    stands for something that will be there.
    """

    tries = 1  # workers that may die of a job: here the next one would die of it too

    def __init__(self, task: Task) -> None:
        self._task = task
        self._pools: list[ProcessPoolExecutor] = []

    def start(self) -> tuple[ProcessPoolExecutor, None]:
        """A new worker, and the ticket of its being ready; None: it is.

        It is a pool of one, so that it is known which job a process died of.
        """
        context = multiprocessing.get_context("spawn")
        arguments = (self._task, os.environ.get(SAFE_PATH))
        with safe_path():  # its locks already start a process that watches them
            pool = ProcessPoolExecutor(
                1, context, initializer=_begin_worker, initargs=arguments
            )
        self._pools.append(pool)
        return pool, None

    def give(self, pool: ProcessPoolExecutor, job: KeyedJob) -> Future:
        with safe_path():  # the first job starts the worker's process
            return pool.submit(_call_task, job)

    def first(self, futures: list[Future], any_ready: bool) -> Future:
        """Wait for one ticket; `any_ready`: some worker has been there."""
        return next(iter(wait(futures, return_when=FIRST_COMPLETED).done))

    def answer(self, future: Future) -> KeyedRow:
        """What a job brought; raises what the job raised, and WorkerDied."""
        try:
            return future.result()
        except BrokenProcessPool:
            raise WorkerDied from None

    def end(self) -> None:
        for pool in self._pools:
            pool.shutdown(wait=True, cancel_futures=True)


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


class _Actor:
    """A worker on Ray."""

    def __init__(self, task: Task) -> None:
        self._task = task

    def ready(self) -> None:
        """Answered as soon as the cluster had room for this worker."""

    def do(self, job: KeyedJob) -> KeyedRow:
        return self._task.do(job)


class OnRay:
    """Workers as actors of the Ray cluster of RAY_ADDRESS, else one here; nodes share all paths."""

    tries = 2  # a node may have gone away, which is not the job's fault

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
        self._actor: Any = ray.remote(**self._asked)(_Actor)
        self._task = ray.put(task)  # once for all workers; photos are paths in it

    def start(self) -> tuple[Any, Any]:
        worker = self._actor.remote(self._task)
        return worker, worker.ready.remote()

    def give(self, worker: Any, job: KeyedJob) -> Any:
        return worker.do.remote(job)

    def first(self, tickets: list[Any], any_ready: bool) -> Any:
        """Raises RunError where the cluster has no room for one worker in `MOST_WAIT` seconds."""
        timeout = None if any_ready else MOST_WAIT
        ready, _ = self._ray.wait(tickets, num_returns=1, timeout=timeout)
        if ready:
            return ready[0]
        has = {
            name: round(amount, 2)
            for name, amount in self._ray.cluster_resources().items()
            if name in ("CPU", "GPU", "memory")
        }
        raise RunError(
            f"no worker got a place on the Ray cluster in {MOST_WAIT} s: each asks for "
            f"{self._asked}, the cluster has {has}; ask for less with --threads, "
            "--gpus-per-worker or --memory-per-worker."
        )

    def answer(self, ticket: Any) -> Any:
        exceptions = self._ray.exceptions
        try:
            return self._ray.get(ticket)
        except exceptions.RayTaskError as error:
            raise error.cause from None
        except exceptions.RayError:
            raise WorkerDied from None

    def end(self) -> None:
        if self._started:
            self._ray.shutdown()


WorkerPool = InProcesses | OnRay


def pool_of(task: Task, workers: Workers) -> WorkerPool:
    """The pool that `workers.spread` names."""
    return OnRay(task, workers) if workers.spread == "ray" else InProcesses(task)
