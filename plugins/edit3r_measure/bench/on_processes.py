"""Items in parallel in processes of this machine."""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from edit3r.errors import RunError
from edit3r_measure.bench.results import ItemResult
from edit3r_measure.bench.runner import Job, work

__all__ = ["on_processes"]

_worker: Callable[[str], ItemResult] | None = None


def on_processes(job: Job, items: list[str], workers: int) -> Iterator[ItemResult]:
    """Results as they come, in any order. New processes: forking one that has used torch's threads can hang."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(items)), context, initializer=_start, initargs=(job,))
    try:
        for future in as_completed([pool.submit(_do, item) for item in items]):
            yield future.result()
    except BrokenProcessPool:
        raise RunError(
            "a worker process died (out of memory, or it could not start); what is done is kept: run again, with fewer "
            "--workers if memory is short."
        ) from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start(job: Job) -> None:
    global _worker
    _worker = work(job)


def _do(item: str) -> ItemResult:
    return _worker(item)
