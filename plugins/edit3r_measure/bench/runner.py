"""Work through a manifest with one method: resume, spread over processes, tell how long it takes."""

import json
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r.io.run_folder import installed_versions
from edit3r_measure.bench.manifest import Manifest, read_bench_manifest
from edit3r_measure.bench.method import InstrumentSettings, Method
from edit3r_measure.bench.results import RUN, ItemResult, append_result, read_results, repair, rewrite_results

__all__ = ["Job", "Progress", "run_job", "work"]


@dataclass(frozen=True)
class Job:
    """Everything a worker needs to start from nothing; picklable."""

    manifest: Path
    method: Method
    out: Path
    instruments: InstrumentSettings = field(default_factory=InstrumentSettings)
    scenes: int | None = None  # only the first
    edits: int | None = None  # only the first of each scene
    types: tuple[str, ...] = ()  # only these
    plugins: tuple[str, ...] = ()  # local plugin files
    threads: int = 1  # of torch in each process: sums are in the same order however many workers there are
    verify: bool = True
    position: int = 0  # of the method's column in reports

    def read_manifest(self) -> Manifest:
        """The part of the manifest that is asked for."""
        return read_bench_manifest(self.manifest).limited(self.scenes, self.edits, self.types)


@dataclass(frozen=True)
class Progress:
    """Told after each item."""

    result: ItemResult
    done: int
    total: int
    seconds_left: float


def run_job(
    job: Job,
    workers: int = 1,
    spread: Literal["processes", "ray"] = "processes",
    on_item: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, ItemResult]:
    """Do what is not done yet; results by item in the manifest's order, also on disk.

    Same results for any number of workers, on processes or on Ray. Raises InputError when the folder holds results of
    another manifest or method.
    """
    manifest = job.read_manifest()
    if not manifest.items:
        raise InputError(f"{job.manifest}: no edit is left to do with these limits.")
    _claim(job, manifest)
    repair(job.out)
    done = read_results(job.out)
    wanted = [item.id for item in manifest.items]
    left = [name for name in wanted if name not in done]
    start = time.monotonic()
    for count, result in enumerate(_results(job, left, workers, spread), start=1):
        append_result(job.out, result)
        done[result.id] = result
        rate = (time.monotonic() - start) / count
        on_item(Progress(result, len(wanted) - len(left) + count, len(wanted), rate * (len(left) - count)))
    ordered = {name: done[name] for name in wanted}
    others = [result for name, result in done.items() if name not in ordered]
    rewrite_results(job.out, [*ordered.values(), *others])
    return ordered


def work(job: Job) -> Callable[[str], ItemResult]:
    """A worker: item id to result, with everything built once."""
    import torch

    from edit3r.registry import default_registry
    from edit3r_measure.bench.one_item import Bench, build_instruments

    torch.set_num_threads(job.threads)
    registry = default_registry(job.plugins)
    instruments = build_instruments(job.instruments, registry)
    return Bench(job.read_manifest(), job.manifest.parent, job.method, job.out, registry, instruments, job.verify)


def _results(job: Job, items: list[str], workers: int, spread: str) -> Iterable[ItemResult]:
    if not items:
        return iter(())
    if spread == "ray":
        from edit3r_measure.bench.on_ray import on_ray

        return on_ray(job, items, workers)
    if workers == 1:
        return map(work(job), items)
    from edit3r_measure.bench.on_processes import on_processes

    return on_processes(job, items, workers)


def _claim(job: Job, manifest: Manifest) -> None:
    """Write what this folder's results are of, or refuse one that holds others."""
    try:
        job.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{job.out}: cannot be created ({error.strerror}); give --out another folder.") from None
    whole = read_bench_manifest(job.manifest)
    wish = {
        "format": "edit3r-bench-run",
        "manifest": whole.name,
        "manifest_sha256": whole.sha256,
        "method": job.method.model_dump(mode="json"),
        "instruments": job.instruments.model_dump(mode="json"),
        "threads": job.threads,
        "verified": job.verify,
    }
    about = {"position": job.position, "versions": installed_versions()}
    path = job.out / RUN
    if path.is_file():
        for key, value in _read(path).items():
            if key in wish and wish[key] != value:
                raise InputError(
                    f"{job.out}: holds results with another {key.replace('_', ' ')}; choose another --out."
                )
        return
    if any(not path.name.startswith(".") for path in job.out.iterdir()):  # a kill may leave a hidden half of ours
        raise InputError(f"{job.out}: holds files that are not of a benchmark run; choose another --out.")
    with atomic_write(path) as partial:
        text = json.dumps({**wish, **about}, indent=1, ensure_ascii=False)
        partial.write_text(text + "\n", encoding="utf-8")


def _read(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}).") from None
