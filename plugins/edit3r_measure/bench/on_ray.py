"""Items in parallel on a Ray cluster (extra `ray`): one here, or the one that RAY_ADDRESS names."""

import os
from collections.abc import Callable, Iterator

from edit3r.errors import MissingDependencyError
from edit3r_measure.bench.results import ItemResult
from edit3r_measure.bench.runner import Job, work

__all__ = ["on_ray"]


class _Worker:
    """An actor: one built method that takes items one by one."""

    def __init__(self, job: Job) -> None:
        self.do: Callable[[str], ItemResult] = work(job)

    def one(self, item: str) -> ItemResult:
        return self.do(item)


def on_ray(job: Job, items: list[str], workers: int) -> Iterator[ItemResult]:
    """Results as they come. All nodes must see the manifest's folder and the output folder under the same paths."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
        from ray.util import ActorPool
    except ImportError:
        raise MissingDependencyError('--ray needs Ray; install with: pip install "edit3r[ray]"') from None
    started = not ray.is_initialized()
    if started:
        address = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": workers, "include_dashboard": False}
        ray.init(log_to_driver=False, **address)
    try:
        actor = ray.remote(num_cpus=job.threads)(_Worker)
        pool = ActorPool([actor.remote(job) for _ in range(min(workers, len(items)))])
        yield from pool.map_unordered(lambda worker, item: worker.one.remote(item), items)
    finally:
        if started:
            ray.shutdown()
