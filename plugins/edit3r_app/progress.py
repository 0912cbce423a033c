"""What a run is doing, read from its log, and how long it still needs."""

import contextlib
import json
import time
from dataclasses import dataclass, field
from pathlib import Path

from edit3r_app.jobs import AppJob, JobsFolder, manifest_of

STEPS = (
    *("read photos", "load components", "geometry", "select", "edit", "reconstruct"),
    *("refine", "check", "render", "write files"),
)
"""Stages of a run, of which the bar shows how many are behind."""


@dataclass
class RunProgress:
    """How far a run of the app is, by its log of events."""

    # seconds of the finished stages
    done: dict[str, float] = field(default_factory=dict)
    stage: str = ""
    share: float | None = None  # of the stage's current step, in [0, 1]
    whole: float = 0.0  # of all steps, in [0, 1]; never less than before
    since: float = 0.0  # when the stage began [seconds since 1970]
    told: list[str] = field(default_factory=list)  # choices and warnings
    error: str = ""  # the sentence of a run that failed

    def take(self, line: str) -> None:
        """Read one event; raises KeyError, TypeError or ValueError for any other line."""
        event = json.loads(line)
        kind = event["event"]
        text = str(event["text"])
        if kind == "start":
            self.stage = text
            self.since = float(event["at"])
            self.share = None
            self._step()
        elif kind == "end":
            self.done[text] = float(event["at"]) - self.since
            self.stage = ""
        elif kind in ("say", "warn"):
            self.told.append(text)
        elif kind == "progress" and event["total"]:
            self.share = event["done"] / event["total"]
            self._step()

    def _step(self) -> None:
        """Count the steps that are behind; a scene is read in place of photos."""
        name = self.stage.partition(" (")[0].replace("read scene", STEPS[0])
        if name in STEPS:
            reached = (STEPS.index(name) + (self.share or 0)) / len(STEPS)
            self.whole = max(self.whole, reached)


def read_progress(log: Path) -> RunProgress:
    """Read a log; of lines that are no events only the program's sentence about an error counts."""
    progress = RunProgress()
    text = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    for line in text.splitlines():
        if line.startswith("edit3r: "):
            progress.error = line.removeprefix("edit3r: ")
        with contextlib.suppress(KeyError, TypeError, ValueError):
            progress.take(line)
    return progress


def time_left(folder: JobsFolder, job: AppJob, progress: RunProgress) -> float | None:
    """Seconds that a run still needs, by the stages of the newest run of the same reconstructor.

    None where there was none.
    """
    usual = {}
    for other in folder.jobs():
        same = other.settings.get("reconstructor") == job.settings.get("reconstructor")
        if same and other.state == "done":
            with contextlib.suppress(KeyError, TypeError, ValueError):
                stages = manifest_of(folder.root / other.name)["stages"]
                usual = {one["name"]: float(one["seconds"]) for one in stages}
    if not usual:
        return None
    spent = time.time() - progress.since
    left = max(0.0, usual.pop(progress.stage, spent) - spent)
    rest = [usual[stage] for stage in usual if stage not in progress.done]
    return left + sum(rest)
