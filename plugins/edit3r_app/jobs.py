"""The jobs folder: everything the app knows is a file in it, so that a reload or a restart loses
nothing.

NAME/                 a set of photos (`NAME/images`, as `edit3r run NAME` takes it) or the folder
of a run .edit3r-app/NAME.json what was asked for in run NAME, and what came of it; without one, a
run of the command line .edit3r-app/NAME.log  the child process's progress, one line of JSON an
event .edit3r-app/NAME/     its masks, or the marks on a set of photos
"""

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r.io.images import SUFFIXES, find_photos, is_plain_name, unique_names

PRIVATE = ".edit3r-app"
DRAFT = "upload-"  # how the names of files begin in it that are still being received
State = Literal["queued", "running", "done", "failed", "cancelled"]
NOTHING_MORE = ("done", "failed", "cancelled")


@dataclass(frozen=True)
class Job:
    """One edit that was asked for: what `edit3r run` is called with, and what came of it."""

    name: str  # of its run folder
    scene: str  # the set of photos, or the run of the command line, that its history begins with
    parent: str = ""  # the run whose scene is edited again; "": from the photos
    settings: dict[str, Any] = field(
        default_factory=dict
    )  # of the run, as a configuration file holds them
    masks: int = 0  # how many mask files there are, one for each photo; 0: none
    size: int = 512  # of the photos [pixels]
    state: State = "queued"
    sentence: str = ""  # why it failed, or the verdict's reason
    label: str = ""  # the verdict, once done
    pid: int = 0  # of the child process that runs it
    made: float = 0.0  # when it was asked for [seconds since 1970]

    @property
    def prompt(self) -> str:
        return str(self.settings.get("prompt", ""))


@dataclass(frozen=True)
class Scene:
    """What a history begins with."""

    name: str
    photos: int
    edits: int


_JOB = TypeAdapter(Job)


class JobsFolder:
    """Reads and writes the jobs folder; holds nothing in memory."""

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root).expanduser().resolve()
        self.private = self.root / PRIVATE
        try:
            self.private.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{self.root}: cannot be the jobs folder ({error.strerror}); give --jobs another."
            ) from None

    def path(self, name: str) -> Path:
        """Folder of a set of photos or a run. Raises InputError for anything that is no name of
        one.
        """
        if (
            is_plain_name(name)
            and not name.startswith(".")
            and (self.root / name).is_dir()
        ):
            return self.root / name
        raise InputError(
            f"{str(name)[:60]!r}: no photos and no run of that name in {self.root}."
        )

    def is_run(self, name: str) -> bool:
        return (self.root / name / "run.json").is_file()

    def scenes(self) -> list[Scene]:
        """All that a history can begin with, newest first."""
        jobs = list(self.jobs())
        roots = {job.scene for job in jobs} | {
            path.parent.name for path in self.root.glob("*/images")
        }
        found = []
        for name in roots:
            try:
                photos = len(self.photos(name))
            except InputError:  # its folder was taken away
                continue
            edits = sum(job.scene == name and job.name != name for job in jobs)
            found.append((self.path(name).stat().st_mtime, Scene(name, photos, edits)))
        return [
            scene for _, scene in sorted(found, key=lambda one: (-one[0], one[1].name))
        ]

    def photos(self, name: str) -> list[Path]:
        """Picture files of a set of photos, or of what a run was made from; none yet is no
        error.
        """
        folder = self.path(name)
        if self.is_run(name):
            return self.pictures(name, "inputs")
        images = folder / "images"
        return (
            find_photos([images])
            if any(p.suffix.lower() in SUFFIXES for p in images.glob("*"))
            else []
        )

    def pictures(self, run: str, kind: str) -> list[Path]:
        """The pictures of a run, one for each of its photos: kind inputs, edited or renders."""
        folder = self.path(run)
        names = (
            [path.name for path in find_photos([folder / "inputs"])]
            if (folder / "inputs").is_dir()
            else []
        )
        return [folder / kind / name for name in names]

    def new_scene(self, wish: str) -> str:
        """Make an empty set of photos, called after `wish` as far as that can be a name."""
        taken = [path.name for path in self.root.iterdir()]
        name = unique_names([*taken, wish.strip(". ") or "scene"])[-1]
        (self.root / name / "images").mkdir(parents=True)
        return name

    # ---- jobs ----

    def new_job(self, job: Job) -> Job:
        """Write down a job under a name that is still free; `job.name` is ignored."""
        stem, number = job.scene[:80], 1
        while (self.root / f"{stem}-{number}").exists() or self._record(
            f"{stem}-{number}"
        ).exists():
            number += 1
        job = replace(job, name=f"{stem}-{number}", made=time.time())
        self.write(job)
        return job

    def write(self, job: Job) -> None:
        with atomic_write(self._record(job.name)) as partial:
            partial.write_text(json.dumps(asdict(job), indent=1), encoding="utf-8")

    def jobs(self) -> Iterator[Job]:
        """Every run that was asked for or that lies there, in the order of asking."""
        names = {
            path.parent.name
            for path in self.root.glob("*/run.json")
            if is_plain_name(path.parent.name)
        }
        names = {name for name in names if not name.startswith(".")}
        names |= {path.stem for path in self.private.glob("*.json")}
        found = [job for job in map(self._read, names) if job is not None]
        return iter(sorted(found, key=lambda job: (job.made, job.name)))

    def job(self, name: str) -> Job:
        """One job. Raises InputError where there is none of that name."""
        job = (
            self._read(name)
            if is_plain_name(name) and not name.startswith(".")
            else None
        )
        if job is None:
            raise InputError(f"{str(name)[:60]!r}: no run of that name in {self.root}.")
        return job

    def history(self, scene: str) -> list[Job]:
        """The jobs of one scene, in the order of asking; the parent of each is in the list, or is
        the scene itself.
        """
        return [job for job in self.jobs() if job.scene == scene]

    def log(self, name: str) -> Path:
        return self.private / f"{name}.log"

    def beside(self, name: str) -> Path:
        """Folder for what belongs to a scene or a job and is no result."""
        folder = self.private / name
        folder.mkdir(exist_ok=True)
        return folder

    def _record(self, name: str) -> Path:
        return self.private / f"{name}.json"

    def _read(self, name: str) -> Job | None:
        """What the record and the run folder say; a run of the command line has no record."""
        run = self.root / name
        try:
            job = _JOB.validate_json(self._record(name).read_bytes())
        except (OSError, ValueError):  # no record, or a damaged one
            job = Job(
                name,
                scene=name,
                state="done",
                made=run.stat().st_mtime if run.is_dir() else 0.0,
            )
            if not self.is_run(name):
                return None
        if not self.is_run(name):
            return replace(
                job, name=name, state="failed" if job.state == "done" else job.state
            )
        manifest = manifest_of(run)
        verdict = (
            manifest.get("verdict") if isinstance(manifest.get("verdict"), dict) else {}
        )
        label, reason = (
            str(verdict.get(key, ""))[:1000] for key in ("label", "reason")
        )
        settings = job.settings or {"prompt": str(manifest.get("prompt", ""))}
        return replace(
            job,
            name=name,
            state="done",
            label=label,
            sentence=reason,
            settings=settings,
        )


def manifest_of(run: Path) -> dict[str, Any]:
    """Content of a run's run.json; empty where it cannot be read, since the folder may come from a
    stranger.
    """
    try:
        return _read_manifest(run / "run.json", (run / "run.json").stat().st_mtime_ns)
    except (OSError, ValueError, RecursionError):
        return {}


@lru_cache(maxsize=1024)
def _read_manifest(path: Path, changed: int) -> dict[str, Any]:
    content = json.loads(path.read_text(encoding="utf-8"))
    return content if isinstance(content, dict) else {}


def undo(history: list[Job], at: str) -> str | None:
    """The name of what was before `at` ("": the photos); None where nothing was."""
    job = next((job for job in history if job.name == at), None)
    if job is None or job.name == job.scene:
        return None
    return job.parent


def redo(history: list[Job], at: str) -> str | None:
    """The newest finished edit made from `at`; None where there is none."""
    after = [
        job.name
        for job in history
        if job.parent == at and job.state == "done" and job.name not in (at, job.scene)
    ]
    return after[-1] if after else None


def tree(history: list[Job]) -> list[tuple[int, Job]]:
    """(depth, job) with every job below the one that it goes on from; siblings in the order of
    asking.
    """
    names = {job.name for job in history}

    def below(parent: str, depth: int) -> Iterator[tuple[int, Job]]:
        for job in history:
            if (
                job.parent if job.parent in names else ""
            ) == parent and job.name != parent:
                yield depth, job
                yield from below(job.name, depth + 1)

    return list(below("", 0))
