"""Progress, notes and warnings of a component, and the memory of this process.

Inside a run, `track` moves a progress bar, `note` puts a fact into `run.json` and `warn` tells the
user: all three go to the run's `Report`. Outside a run the first two do nothing and `warn` is
Python's own, so a component can be used without a run.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

Item = TypeVar("Item")


@dataclass
class StageRecord:
    """One finished stage: its name, wall and CPU seconds, and the process's peak memory then."""

    name: str
    seconds: float
    cpu_seconds: float
    peak_memory_mb: float


@dataclass
class Report:
    """What one run collected.

    `on_event` is called as (event, text, done, total) as things happen; events are start and end of
    a stage, say, warn and progress.
    """

    stages: list[StageRecord] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    on_event: Callable[[str, str, int, int], None] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What a copy or a pickle takes along: whoever listens here listens to no copy."""
        return {**vars(self), "on_event": None}

    def emit(self, event: str, text: str, done: int = 0, total: int = 0) -> None:
        if self.on_event is not None:
            self.on_event(event, text, done, total)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage; nothing is recorded for one that raises."""
        self.emit("start", name)
        wall, cpu = time.perf_counter(), time.process_time()
        yield
        record = StageRecord(
            name,
            time.perf_counter() - wall,
            time.process_time() - cpu,
            peak_memory_mb(),
        )
        self.stages.append(record)
        self.emit("end", name)


_current: ContextVar[Report | None] = ContextVar("edit3r_report", default=None)


@contextmanager
def collecting(report: Report) -> Iterator[Report]:
    """Send `note`, `warn` and `track` calls inside the block to `report`."""
    token = _current.set(report)
    try:
        yield report
    finally:
        _current.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Time a stage of the current run; outside a run nothing is recorded."""
    report = _current.get()
    with nullcontext() if report is None else report.stage(name):
        yield


def note(key: str, value: Any) -> None:
    """Record a fact under `key` (dots group) in the run's manifest; `value` must be JSON data."""
    report = _current.get()
    if report is not None:
        report.notes[key] = value


def say(key: str, text: str) -> None:
    """Note a choice that was made for the user under `key`, and show it; once per text."""
    report = _current.get()
    if report is not None and report.notes.get(key) != text:
        note(key, text)
        report.emit("say", f"{key.partition('.')[0]}: {text}")


def warn(text: str) -> None:
    """Tell the user something that does not stop the run; once per text, also kept in the manifest.

    Outside a run it is a warning of Python's.
    """
    report = _current.get()
    if report is None:
        warnings.warn(text, stacklevel=2)
    elif text not in report.warnings:
        report.warnings.append(text)
        report.emit("warn", text)


def track(items: Iterable[Item], text: str, total: int | None = None) -> Iterator[Item]:
    """Iterate while showing progress under `text`."""
    if total is None:
        items = list(items)
        total = len(items)
    progress(text, 0, total)
    for done, item in enumerate(items, start=1):
        yield item
        progress(text, done, total)


def progress(text: str, done: int, total: int) -> None:
    """Show that `done` of `total` units of `text` are finished."""
    report = _current.get()
    if report is not None:
        report.emit("progress", text, done, total)


def available_memory() -> int | None:
    """Memory that programs may still take [bytes]; None where the system does not tell."""
    table = Path("/proc/meminfo")
    lines = table.read_text(encoding="ascii").splitlines() if table.is_file() else []
    return next(
        (
            int(line.split()[1]) * 1024
            for line in lines
            if line.startswith("MemAvailable:")
        ),
        None,
    )


def peak_memory_mb() -> float:
    """Peak resident memory of this process so far [MiB]; 0 where the platform does not tell."""
    status = Path("/proc/self/status")
    # Linux's getrusage counts what the parent process had when it started this one
    if status.is_file():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    try:
        import resource
        import sys
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)
