"""The queue: one run at a time, each `edit3r run` in a process of its own, watched through its log
file.

The child's output is its log file, and it holds a lock (flock) on it as long as it lives: a server
that was killed and started again finds the child still running, and goes on watching. A record may
be a stranger's: no process is ended because its number stands there.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import IO

import yaml

from edit3r.contract.errors import InputError
from edit3r.kit.children import PYTHON
from edit3r.kit.files.atomic import atomic_write, remove_abandoned
from edit3r.running import DEFAULTS
from edit3r_app.jobs import ASKED, AppJob, JobsFolder
from edit3r_app.objects import checked_words
from edit3r_app.progress import read_progress
from edit3r_app.ready import CAN_WAIT, WAITING, ReadyProcess
from edit3r_app.uploads import DRAFT

# On Windows a restarted server cannot tell whether a child still runs.
if sys.platform != "win32":
    import fcntl

EDIT3R = (*PYTHON, "-m", "edit3r")
"""The command `edit3r`; no file of the current folder is imported."""

OUTPUTS = [one for one in DEFAULTS["outputs"] if one != "video"]
"""What a run of the app writes; a video is made when somebody asks for it."""
PATIENCE = 5.0  # [s] between asking a child to stop and ending it; no figure kept
INTERRUPTED = "the run ended without saying why; start it again."


def command_of(folder: JobsFolder, job: AppJob) -> list[str]:
    """The arguments of `edit3r` that carry out a job; its settings are written beside it first."""
    beside = folder.beside(job.name)
    masks = [str(beside / f"{index:03}.png") for index in range(job.masks)]
    out = ["--out", str(folder.root / job.name)]
    if job.object:
        marked = ["--mask", *masks] if masks else []
        if job.drawn:
            marked = ["--drawn", str(beside / ASKED)]
        run = str(folder.path(job.parent))
        words = checked_words(job.object)
        return ["objects", "--quiet", *out, *marked, "--", run, *words]
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

    def __init__(self, folder: JobsFolder, program: tuple[str, ...] = EDIT3R) -> None:
        self.folder = folder
        self.program = program
        self.trouble = ""  # why jobs wait though nothing runs, such as a full disk
        self._child: subprocess.Popen | None = None
        self._ready: ReadyProcess | None = None
        self._stopping = threading.Event()
        self._changing = threading.RLock()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._server = (folder.private / ".lock").open("a")
        if not _locked(self._server):
            raise InputError(
                f"{folder.root}: another `edit3r app` works in this folder; give --jobs another."
            )

    def clear_left_over(self) -> None:
        """Remove the halves of uploads that a killed server left."""
        for draft in self.folder.private.glob(f"{DRAFT}*"):
            draft.unlink(missing_ok=True)

    def start(self) -> None:
        self.clear_left_over()
        self._thread.start()

    def make_ready(self) -> None:
        """Have a process that begins the next run at once."""
        with self._changing:
            is_ours = self.program == EDIT3R and self._thread.is_alive()
            if CAN_WAIT and is_ours and self._ready is None:
                self._ready = ReadyProcess()

    def renew(self) -> None:
        """End the process that waits: what it would import is another now."""
        with self._changing:
            if self._ready is not None:
                self._ready.end()
                self._ready = None

    def stop(self) -> None:
        """End the run in progress; it is queued again for the next start of the app."""
        self._stopping.set()
        self.renew()
        with self._changing:
            for job in self._running():
                self._end(job)
                self.folder.write(replace(job, state="queued", pid=0))
        self._server.close()

    def cancel(self, name: str) -> None:
        """End a running job or take a queued one out of the queue; its record stays."""
        with self._changing:
            job = self.folder.job(name)
            if job.pid:
                self._end(job)
            if job.is_active:
                told = "you cancelled it."
                self.folder.write(replace(job, state="cancelled", pid=0, sentence=told))

    def step(self) -> None:
        """DraftAnswer after the run in progress, and start the next when there is none."""
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
                self.trouble = ""
            # the queue outlives a disk that is full for a while
            except Exception as error:
                self.trouble = str(error)
                time.sleep(1)

    def _running(self) -> list[AppJob]:
        """Jobs whose child nobody has seen end, though their results may be there."""
        return [job for job in self.folder.jobs() if job.pid]

    def _begin(self, job: AppJob) -> None:
        log = self.folder.log(job.name)
        if log.is_symlink():  # a stranger's, which may lead elsewhere
            log.unlink()
        with log.open("ab") as output:
            if not _locked(output):  # a child of a killed server still works on it
                return
            output.truncate(0)
            try:
                self._child = self._started(command_of(self.folder, job), output)
            # else it would come up again, before all later jobs
            except Exception as error:
                self.folder.write(replace(job, state="failed", sentence=str(error)))
                return
        pid = self._child.pid
        self.folder.write(
            replace(job, state="running", pid=pid, began=_process(pid)[0])
        )

    def _started(self, command: list[str], output: IO) -> subprocess.Popen:
        """A process that carries out a command: the one that waits, or a new one."""
        ready, self._ready = self._ready, None
        child = None if ready is None else ready.begin(command, output)
        return child or subprocess.Popen(
            [*self.program, *command],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )

    def _alive(self, job: AppJob) -> bool:
        if self._child is not None and self._child.pid == job.pid:
            return self._child.poll() is None
        log = self.folder.log(job.name)
        if not log.is_file() or log.is_symlink():
            return False
        with log.open("rb") as output:
            is_servers = os.path.sameopenfile(output.fileno(), self._server.fileno())
            return not is_servers and not _locked(output)

    def _is_ours(self, job: AppJob) -> bool:
        """Whether the process of a record is the child that was started for it."""
        if self._child is not None and self._child.pid == job.pid:
            return True
        began, command = _process(job.pid)
        programs = tuple("\0".join(one) for one in (self.program, WAITING))
        return began > 0 and began == job.began and command.startswith(programs)

    def _end(self, job: AppJob) -> None:
        """Interrupt the child, which then removes what it began; end it where it does not obey."""
        is_ours = self._is_ours(job)
        for kind in (signal.SIGINT, getattr(signal, "SIGKILL", signal.SIGTERM)):
            asked = time.monotonic()
            if is_ours and self._alive(job):
                _send(kind, job.pid)
            while is_ours and self._alive(job) and time.monotonic() - asked < PATIENCE:
                time.sleep(0.05)
        remove_abandoned(self.folder.root / job.name)

    def _finish(self, job: AppJob) -> None:
        """Write down how a child ended; what it made is in its folder, or nothing is."""
        if job.state == "running":
            error = read_progress(self.folder.log(job.name)).error
            job = replace(job, state="failed", sentence=error or INTERRUPTED)
            remove_abandoned(self.folder.root / job.name)  # it may have been killed
        self.folder.write(replace(job, pid=0))


def _process(pid: int) -> tuple[int, str]:
    """When a process began [clock ticks since the machine did], and its command.

    (0, "") where there is none, or the system (not Linux) does not say.
    """
    place = Path(f"/proc/{pid}")
    with contextlib.suppress(OSError):
        began = (place / "stat").read_bytes().rpartition(b")")[2].split()[19]
        return int(began), os.fsdecode((place / "cmdline").read_bytes())
    return 0, ""


def _send(kind: signal.Signals, pid: int) -> None:
    """Send a signal to a child and all that it started."""
    with contextlib.suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(pid, kind)
        else:
            os.kill(pid, kind)
