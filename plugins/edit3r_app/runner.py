"""The queue: one run at a time, each `edit3r run` in a process of its own, watched through its log
file.

The child's output is its log file, and it holds a lock (flock) on it as long as it lives: a server
that was killed and started again finds the child still running, and goes on watching.
"""

import contextlib
import glob
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import yaml

from edit3r.errors import InputError
from edit3r.io.children import PYTHON
from edit3r_app.jobs import DRAFT, NOTHING_MORE, Job, JobsFolder, manifest_of

try:
    import fcntl
except (
    ImportError
):  # Windows: a restarted server cannot tell whether a child still runs
    fcntl = None

PATIENCE = 5.0  # [s] between asking a child to stop and ending it
INTERRUPTED = "the app was stopped while this edit ran; start it again."


@dataclass
class Progress:
    """What a run is doing, read from its log."""

    done: list[tuple[str, float]] = field(
        default_factory=list
    )  # finished stages and their seconds
    stage: str = ""
    share: float | None = None  # of the stage's current step, in [0, 1]
    since: float = 0.0  # when the stage began [seconds since 1970]
    warnings: list[str] = field(default_factory=list)
    error: str = ""  # the sentence of a run that failed


def read_progress(log: Path) -> Progress:
    """Read a log; lines that are no events are passed over, but for the program's sentence about an
    error.
    """
    progress = Progress()
    with contextlib.suppress(OSError):
        for line in log.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("edit3r: "):
                progress.error = line.removeprefix("edit3r: ")
            with contextlib.suppress(ValueError, TypeError, KeyError):
                event = json.loads(line)
                _apply(progress, event["event"], str(event["text"]), event)
    return progress


def _apply(progress: Progress, event: str, text: str, line: dict[str, Any]) -> None:
    if event == "start":
        progress.stage, progress.since, progress.share = text, float(line["at"]), None
    elif event == "end":
        progress.done.append((text, float(line["at"]) - progress.since))
        progress.stage, progress.share = "", None
    elif event == "warn":
        progress.warnings.append(text)
    elif event == "progress" and line["total"]:
        progress.share = line["done"] / line["total"]


def time_left(
    folder: JobsFolder, job: Job, progress: Progress, now: float
) -> float | None:
    """Seconds that the run still needs, by the newest run of the same editor and reconstructor;
    None: nobody knows.
    """
    usual = _usual_seconds(folder, job)
    if not usual:
        return None
    finished = {name for name, _ in progress.done}
    here = now - progress.since if progress.stage else 0.0
    rest = sum(
        seconds
        for name, seconds in usual.items()
        if name not in finished and name != progress.stage
    )
    return rest + max(usual.get(progress.stage, here) - here, 0.0)


def _usual_seconds(folder: JobsFolder, job: Job) -> dict[str, float]:
    """Seconds of each stage of the newest run with the same components."""
    for other in reversed([other for other in folder.jobs() if other.state == "done"]):
        if all(
            _name(other, kind) == _name(job, kind)
            for kind in ("editor", "reconstructor")
        ):
            stages = manifest_of(folder.root / other.name).get("stages")
            with contextlib.suppress(TypeError, KeyError, ValueError):
                return {str(stage["name"]): float(stage["seconds"]) for stage in stages}
    return {}


def _name(job: Job, kind: str) -> str:
    choice = job.settings.get(kind)
    return (
        str(choice.get("name", "")) if isinstance(choice, dict) else str(choice or "")
    )


def command_of(folder: JobsFolder, job: Job) -> list[str]:
    """The call of `edit3r run` that carries out a job; its settings and masks are written beside
    the job first.
    """
    beside = folder.beside(job.name)
    settings = beside / "settings.yaml"
    settings.write_text(
        yaml.safe_dump({"size": job.size, **job.settings}, allow_unicode=True),
        encoding="utf-8",
    )
    command = [
        "run",
        "--config",
        str(settings),
        "--out",
        str(folder.root / job.name),
        "--progress",
        "json",
    ]
    if job.parent:
        command += ["--from", str(folder.path(job.parent))]
    else:
        command += [str(path) for path in folder.photos(job.scene)]
    if job.masks:
        command += [
            "--mask",
            *(str(beside / f"{index:03}.png") for index in range(job.masks)),
        ]
    return command


def _locked(file: IO) -> bool:
    """Lock a file as long as it is open; False where another process holds the lock."""
    with contextlib.suppress(OSError):
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False


class Runner:
    """Works off the queued jobs of a folder, in the order of asking, one at a time."""

    def __init__(
        self,
        folder: JobsFolder,
        program: tuple[str, ...] = (*PYTHON, "-m", "edit3r"),
    ) -> None:
        self.folder, self.program = folder, program
        self._child: subprocess.Popen | None = None
        self._stopping = threading.Event()
        self._changing = threading.RLock()
        self._server = (folder.private / "lock").open("a")
        if not _locked(self._server):
            raise InputError(
                f"{folder.root}: another `edit3r app` works in this folder; give --jobs another."
            )
        self._thread = threading.Thread(target=self._work, daemon=True)

    def clear_left_over(self) -> None:
        """Remove the halves of uploads that a killed server left; no other server works in this
        folder.
        """
        for draft in self.folder.private.glob(f"{DRAFT}*"):
            draft.unlink(missing_ok=True)

    def start(self) -> None:
        self.clear_left_over()
        for job in (
            self.folder.jobs()
        ):  # written down as running, but nothing says by which process
            if (
                job.state == "running"
                and not (self.folder.private / f"{job.name}.pid").exists()
            ):
                self.folder.write(replace(job, state="queued"))
        self._thread.start()

    def stop(self) -> None:
        """End the run in progress; it is queued again, so that the next start of the app takes it
        up.
        """
        self._stopping.set()
        with self._changing:
            for job in self._running():
                self._end(job)
                self.folder.write(replace(job, state="queued", pid=0))
        self._server.close()

    def submit(self, job: Job, masks: int) -> None:
        """Queue a job whose masks have been written."""
        with self._changing:
            self.folder.write(replace(job, state="queued", masks=masks))

    def cancel(self, name: str) -> None:
        """End a running job or take a queued one out of the queue; its record stays."""
        with self._changing:
            job = self.folder.job(name)
            if job.state == "running":
                self._end(job)
            if job.state not in NOTHING_MORE:
                self.folder.write(
                    replace(job, state="cancelled", pid=0, sentence="cancelled")
                )

    def step(self) -> None:
        """Look after the run in progress, and start the next when there is none."""
        with self._changing:
            if self._stopping.is_set():
                return
            for job in self._running():
                if self._alive(job):
                    return
                self._finish(job)
            waiting = [job for job in self.folder.jobs() if job.state == "queued"]
            if waiting:
                self._begin(waiting[0])

    def _work(self) -> None:
        while not self._stopping.wait(0.2):
            try:
                self.step()
            except (
                Exception
            ) as error:  # the queue must outlive a disk that is full for a while
                print(f"edit3r app: the queue: {error}", file=sys.stderr)
                time.sleep(1)

    def _running(self) -> Iterator[Job]:
        """Jobs that a child process was started for and that nobody has finished, though their
        results may be there.
        """
        for path in self.folder.private.glob("*.pid"):
            with contextlib.suppress(InputError):
                yield replace(
                    self.folder.job(path.stem), pid=int(path.read_text() or 0)
                )

    def _begin(self, job: Job) -> None:
        with self.folder.log(job.name).open("ab") as output:
            if not _locked(
                output
            ):  # its child of before the server was killed still runs
                return
            output.truncate(0)
            try:
                command = [*self.program, *command_of(self.folder, job)]
                self._child = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    start_new_session=True,
                )
            except (InputError, OSError) as error:
                self.folder.write(replace(job, state="failed", sentence=str(error)))
                return
        (self.folder.private / f"{job.name}.pid").write_text(str(self._child.pid))
        self.folder.write(replace(job, state="running", pid=self._child.pid))

    def _alive(self, job: Job) -> bool:
        if self._child is not None and self._child.pid == job.pid:
            return self._child.poll() is None
        with (
            contextlib.suppress(FileNotFoundError),
            self.folder.log(job.name).open("rb") as log,
        ):
            return not _locked(log)
        return False

    def _end(self, job: Job) -> None:
        """Interrupt the child, which then removes what it began; end it where it does not obey."""
        for kind in (signal.SIGINT, getattr(signal, "SIGKILL", signal.SIGTERM)):
            if not self._alive(job):
                break
            with contextlib.suppress(OSError):
                os.killpg(job.pid, kind) if hasattr(os, "killpg") else os.kill(
                    job.pid, kind
                )
            asked = time.monotonic()
            while self._alive(job) and time.monotonic() - asked < PATIENCE:
                time.sleep(0.05)
        for partial in self.folder.root.glob(f".{glob.escape(job.name)}.partial-*"):
            shutil.rmtree(
                partial, ignore_errors=True
            ) if partial.is_dir() else partial.unlink(missing_ok=True)
        (self.folder.private / f"{job.name}.pid").unlink(missing_ok=True)

    def _finish(self, job: Job) -> None:
        """Write down how a child ended; what it made is in its folder, or nothing is."""
        error = read_progress(self.folder.log(job.name)).error
        if job.state == "done":
            self.folder.write(replace(job, pid=0))
        else:
            self.folder.write(
                replace(job, state="failed", pid=0, sentence=error or INTERRUPTED)
            )
        (self.folder.private / f"{job.name}.pid").unlink(missing_ok=True)
