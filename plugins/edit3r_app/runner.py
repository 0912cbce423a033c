"""The queue: one run at a time, each `edit3r run` in a process of its own, watched through its log
file.

A server that ends, however that is, ends its run; the next start of the app takes that up again.
"""

import contextlib
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from typing import IO

import yaml

from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import atomic_write, remove_abandoned
from edit3r.running import DEFAULTS
from edit3r_app.jobs import ASKED, AppJob, JobsFolder, State
from edit3r_app.progress import read_progress
from edit3r_app.ready import PATIENCE, WAITING, begin, send, waiting
from edit3r_app.uploads import DRAFT

if sys.platform != "win32":
    import fcntl

OUTPUTS = [one for one in DEFAULTS["outputs"] if one != "video"]
"""What a run of the app writes; a video is made when somebody asks for it."""
INTERRUPTED = "the run ended without saying why; start it again."


def command_of(folder: JobsFolder, job: AppJob) -> list[str]:
    """The arguments of `edit3r` that carry out a job; its settings are written beside it first."""
    beside = folder.beside(job.name)
    masks = [str(beside / f"{index:03}.png") for index in range(job.masks)]
    out = ["--out", str(folder.root / job.name)]
    if job.object is not None:
        marked = ["--mask", *masks] if masks else []
        if job.drawn:
            marked = ["--drawn", str(beside / ASKED)]
        run = str(folder.path(job.parent))
        return ["objects", "--quiet", *out, *marked, "--", run, *job.object.call]
    settings = beside / "settings.yaml"
    asked = {"size": job.size, "outputs": OUTPUTS, **job.settings}
    content = yaml.safe_dump(asked, allow_unicode=True)
    with atomic_write(settings) as partial:  # never through a stranger's link
        partial.write_text(content, encoding="utf-8")
    command = ["run", "--config", str(settings), "--progress", "json"]
    command += out
    splat = folder.splat(job.parent or job.scene)
    if splat is not None:
        command += [str(splat[0]), "--cameras", str(splat[1])]
    elif job.parent:
        command += ["--from", str(folder.path(job.parent))]
    else:
        command += [str(photo) for photo in folder.photos(job.scene).values()]
    if job.masks:
        command += ["--mask", *masks]
    return command


def _locked(file: IO) -> bool:
    """Lock a file as long as it is open; False where another process holds the lock."""
    with contextlib.suppress(OSError):
        if sys.platform != "win32":
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False


class Runner:
    """Works off the queued jobs of a folder, in the order of asking, one at a time."""

    def __init__(self, folder: JobsFolder, program: tuple[str, ...] = WAITING) -> None:
        self.folder = folder
        self.program = program  # waits for its arguments
        self.trouble = ""  # why jobs wait though nothing runs, such as a full disk
        self._running: tuple[str, subprocess.Popen] | None = None  # a job's name
        self._ready: subprocess.Popen | None = None
        self._stopping = threading.Event()
        self._changing = threading.RLock()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._server = (folder.private / ".lock").open("a")
        if not _locked(self._server):
            raise InputError(
                f"{folder.root}: another `edit3r app` works in this folder; give --jobs another."
            )
        self._clear_left_over()

    def _clear_left_over(self) -> None:
        """Remove the halves of uploads that a killed server left, and queue its run again."""
        for draft in self.folder.private.glob(f"{DRAFT}*"):
            draft.unlink(missing_ok=True)
        for job in self.folder.jobs():
            if job.state == "running":
                remove_abandoned(self.folder.root / job.name)
                self.folder.write(replace(job, state="queued"))

    def start(self) -> None:
        self._thread.start()

    def make_ready(self) -> None:
        """Have a process that begins the next run at once."""
        with self._changing:
            if self._thread.is_alive() and self._ready is None:
                self._ready = waiting(self.program)

    def renew(self) -> None:
        """End the process that waits: what it would import is another now."""
        with self._changing:
            if self._ready is not None:
                self._ready.kill()
                self._ready.wait()
                self._ready = None

    def stop(self) -> None:
        """End the run in progress; it is queued again for the next start of the app."""
        self._stopping.set()
        self.renew()
        with self._changing:
            if self._running is not None:
                self._end("queued")
        self._server.close()

    def cancel(self, name: str) -> None:
        """End a running job or take a queued one out of the queue; its record stays."""
        told = "you cancelled it."
        with self._changing:
            job = self.folder.job(name)
            if self._running is not None and self._running[0] == name:
                self._end("cancelled", told)
            elif job.is_active:
                self.folder.write(replace(job, state="cancelled", sentence=told))

    def step(self) -> None:
        """Look after the run in progress, and start the next when there is none."""
        with self._changing:
            if self._stopping.is_set():
                return
            if self._running is not None:
                if self._running[1].poll() is None:
                    return
                self._end("failed")
            queued = [job for job in self.folder.jobs() if job.state == "queued"]
            if queued:
                self._begin(queued[0])

    def _work(self) -> None:
        while not self._stopping.wait(0.2):
            try:
                self.step()
                self.trouble = ""
            # the queue outlives a disk that is full for a while
            except Exception as error:
                self.trouble = str(error)
                time.sleep(1)

    def _begin(self, job: AppJob) -> None:
        log = self.folder.log(job.name)
        log.unlink(missing_ok=True)  # a stranger's may lead elsewhere
        try:
            command = command_of(self.folder, job)
            child, self._ready = self._ready, None
            if child is None or child.poll() is not None:
                child = waiting(self.program)
            begin(child, command, log)
        # else it would come up again, before all later jobs
        except Exception as error:
            self.folder.write(replace(job, state="failed", sentence=str(error)))
            return
        self._running = job.name, child
        self.folder.write(replace(job, state="running"))

    def _end(self, state: State, sentence: str = "") -> None:
        """End the run in progress, where it still runs, and write down what came of it.

        It is interrupted, so that it removes what it began, and ended where it does not obey.
        """
        assert self._running is not None
        name, child = self._running
        for kind in (signal.SIGINT, getattr(signal, "SIGKILL", signal.SIGTERM)):
            if child.poll() is None:
                send(kind, child.pid)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(PATIENCE)
        if child.stdin is not None:
            child.stdin.close()
        self._running = None
        remove_abandoned(self.folder.root / name)  # it may have been killed
        job = self.folder.job(name)
        if job.state == "running":  # else its folder is there
            if state == "failed":
                sentence = read_progress(self.folder.log(name)).error or INTERRUPTED
            job = replace(job, state=state, sentence=sentence)
        self.folder.write(job)
