"""Run a method through a benchmark, resumable: an item is a line of `results.jsonl`."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import TypeAdapter

from edit3r import Registry, default_registry
from edit3r.contract.errors import (
    InputError,
    MatchingError,
    PluginError,
    PromptError,
    RunError,
)
from edit3r.contract.reporting import Report, StageRecord, collecting
from edit3r.kit.command.results import alone_in, read_json, write_json
from edit3r.kit.provenance import installed_versions
from edit3r.kit.workers import Progress, Workers, read_rows, run_resumable
from edit3r_bench.item import ItemRunner, save_sheet
from edit3r_bench.manifest import ItemRecord, Manifest, load_item, read_bench_manifest
from edit3r_bench.measures import (
    MetricNetworks,
    measure,
    measure_failure,
    remark,
    score,
)
from edit3r_bench.method import Method
from edit3r_bench.options import MetricSettings, RunOptions

RESULTS = "results.jsonl"
RUN = "bench-run.json"
VERSION = 1  # of these files

# Errors that are a result of the method; any other ends the benchmark, since what was asked for was
# wrong
FAILURES = (MatchingError, PromptError, RunError, PluginError)

NOT_BETWEEN = ("start", "read photos", "load components", "check", "write files")
"""Stages of a run that come before it looks at the photos, or after the scene is made."""


@dataclass(frozen=True)
class ItemResult:
    """What one edit gave; one line of `results.jsonl`."""

    id: str
    scene: str
    type: str
    metrics: Mapping[str, float]  # NaN where one means nothing
    failure: str = ""  # why the method gave nothing; "" when it did
    # as `timing_of` tells it; None after a failure
    timing: Mapping[str, Any] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def remark(self) -> str:
        """That the edit changed nothing, in words; "" when it did or failed."""
        return "" if self.failure else remark(self.metrics)


_RESULT = TypeAdapter(ItemResult)


def read_run(folder: Path) -> dict[str, Any]:
    """Return what a folder's results are of. Raises InputError for those of another version."""
    content = read_json(folder / RUN)
    if not isinstance(content, dict) or content.get("version") != VERSION:
        raise InputError(
            f"{folder}: holds results of another version of the benchmark; run it again."
        )
    return content


def read_results(folder: Path) -> dict[str, ItemResult]:
    """Return the results of a folder by item id."""
    return read_rows(folder / RESULTS, "id", _result)


def _result(row: Mapping[str, Any]) -> ItemResult:
    """The result that a line holds, with its score. Raises ValueError and the like."""
    metrics = {
        metric: math.nan if value is None else value
        for metric, value in row["metrics"].items()
    }
    result = _RESULT.validate_python({**row, "metrics": metrics})
    return replace(result, metrics={**metrics, "score": score(metrics, result.failure)})


@dataclass(frozen=True)
class BenchRun:
    """A method on its way through a manifest: turns an item into a row; pickled to each worker."""

    manifest_file: Path
    method: Method
    out: Path
    options: RunOptions = field(default_factory=RunOptions)
    plugins: tuple[str, ...] = ()  # local plugin files
    position: int = 0  # of the method's column in reports

    @cached_property
    def registry(self) -> Registry:
        """The installed components and those of the local plugin files."""
        return default_registry(self.plugins)

    @cached_property
    def manifest(self) -> Manifest:
        """The part of the manifest that is asked for."""
        return read_bench_manifest(self.manifest_file).limited(
            self.options.scenes, self.options.edits
        )

    @cached_property
    def networks(self) -> MetricNetworks:
        """What the metrics need."""
        return MetricNetworks(self.options, self.registry)

    @cached_property
    def runner(self) -> ItemRunner:
        return ItemRunner(self.method, self.registry)

    def __call__(self, record: ItemRecord) -> dict[str, Any]:
        """Do one item; a failure of the method is a result, with its sentence."""
        networks = self.networks  # first, so that a missing one is told at once
        cold = "runner" not in vars(self)
        root = self.manifest_file.parent
        item = load_item(self.manifest, record, root, self.registry)
        result = ItemResult(record.id, record.scene, record.type, {})
        report = Report()
        try:
            with collecting(report), torch.no_grad():
                output = self.runner(item, report)
        except FAILURES as error:
            metrics = measure_failure(item, self.runner.has_truth(item), networks)
            return asdict(replace(result, metrics=metrics, failure=str(error)))
        metrics = measure(item, output, networks)
        save_sheet(self.out / "pictures" / f"{record.id}.webp", item, output)
        facts = {
            "gaussians": output.gaussians,
            "verdict": output.verdict,
            # of the process, so of all methods and networks in it
            "peak_memory_mb": max(stage.peak_memory_mb for stage in report.stages),
            "warnings": report.warnings,
        }
        timing = timing_of(report.stages, cold, item.inputs)
        return asdict(replace(result, metrics=metrics, timing=timing, facts=facts))


def run_bench(
    run: BenchRun, on_done: Callable[[Progress], None] = lambda progress: None
) -> dict[str, ItemResult]:
    """Do the items that are not done yet; return all results in the manifest's order, the same for
    any workers.

    Raises InputError when `run.out` holds results of another manifest or method, or another process
    is at work there.
    """
    if not run.manifest.items:
        raise InputError(f"{run.manifest_file}: these limits leave no edit to run.")
    options = run.options
    spread: Literal["ray", "processes"] = "ray" if options.ray else "processes"
    with alone_in(run.out):
        _claim_folder(run)
        read_results(run.out)  # a line that is none is told before anything is done
        rows = run_resumable(
            {item.id: item for item in run.manifest.items},
            run,
            run.out / RESULTS,
            workers=Workers(options.workers, spread, options.threads),
            key_name="id",
            on_done=on_done,
        )
    return {id: _result(row) for id, row in rows.items()}


def _claim_folder(run: BenchRun) -> None:
    """Write what this folder's results are of, or refuse one that holds others."""
    whole = read_bench_manifest(run.manifest_file)
    asked = {
        "format": "edit3r-bench-run",
        "manifest": whole.name,
        "manifest_sha256": whole.sha256,
        "method": run.method.model_dump(mode="json"),
        "instruments": run.options.model_dump(include={*MetricSettings.model_fields}),
        "threads": run.options.threads,
    }
    if (run.out / RUN).is_file():
        earlier = read_run(run.out)
        for key, value in asked.items():
            if earlier.get(key) != value:
                what = key.replace("_", " ")
                raise InputError(
                    f"{run.out}: holds results with another {what}; choose another --out."
                )
        return
    # A kill may leave a hidden half of ours.
    others = [path for path in run.out.iterdir() if not path.name.startswith(".")]
    if others:
        raise InputError(
            f"{run.out}: holds files that do not belong to a benchmark run; choose another --out."
        )
    more = {
        "version": VERSION,
        "position": run.position,
        "versions": installed_versions(),
    }
    write_json(run.out / RUN, {**asked, **more})


def timing_of(stages: Sequence[StageRecord], cold: bool, views: int) -> dict[str, Any]:
    """Return wall and CPU seconds (`_cpu`) of one edit by part.

    `editor` is the 2D editor, `scene` all else that a run does between photos and scene,
    `rendering` the frames that are measured. Reading files, building components (loading weights),
    measuring and writing are in none. A cold edit is the first of its process. `views` are the
    input photos, by which the paper divides.
    """
    timing: dict[str, Any] = {"cold": cold, "views": views}
    for part in ("editor", "scene", "rendering"):
        own = [stage for stage in stages if _part_of(stage.name) == part]
        timing[part] = sum(stage.seconds for stage in own)
        timing[f"{part}_cpu"] = sum(stage.cpu_seconds for stage in own)
    return timing


def _part_of(stage: str) -> str | None:
    if stage in NOT_BETWEEN:
        return None
    if stage.startswith("edit ("):
        return "editor"
    return "rendering" if stage == "render" else "scene"
