"""The jobs folder: everything the app knows is a file in it, so that a reload or a restart loses
nothing.

NAME/scene/            a scene that was dropped, and the cameras of its pictures in `NAME/images`
NAME/                  a set of photos (`NAME/images`, as `edit3r run NAME` takes it), or the folder
                       of a run
.edit3r-app/NAME.json  what was asked for in run NAME, and what came of it; a run of the command
                       line has none
.edit3r-app/NAME.log   the child process's progress, one line of JSON an event
.edit3r-app/NAME/      its masks and preview, or the marks on a set of photos
.deleted/              a folder of the same kind, with the scenes that were deleted
"""

import itertools
import json
import shutil
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from jaxtyping import Float
from pydantic import TypeAdapter
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.files.names import expanded, is_plain_name, unique_names
from edit3r.kit.files.text import read_json
from edit3r.kit.photos.images import find_photos, save_image
from edit3r.running import RunFolder
from edit3r_app.objects import ObjectAction

PRIVATE = ".edit3r-app"
DELETED = ".deleted"
PREVIEW = "preview"
SPLAT = "scene"
"""Folder of a set of pictures: the scene of which they are."""
KINDS = ("images", "inputs", "edited", "renders", PREVIEW)
"""Folders of images: of a set of photos, of a run, and of what a run will edit."""
ASKED = "asked.json"
"""File beside a job: what was drawn over the scene before it."""

State = Literal["queued", "running", "done", "failed", "cancelled"]


@dataclass(frozen=True)
class AppJob:
    """One edit that was asked for: what `edit3r run` is called with, and what came of it."""

    name: str  # of its run folder
    scene: str  # the set of photos, or the run of the command line, that its history begins with
    parent: str = ""  # the run whose scene is edited again; "": from the photos
    # of the run, as a configuration file holds them
    settings: dict[str, Any] = field(default_factory=dict)
    # what `edit3r objects` is asked for instead of an edit
    object: ObjectAction | None = None
    drawn: bool = False  # whether that is about what is drawn over the scene
    masks: int = 0  # how many mask files there are, one for each photo; 0: none
    size: int = 512  # of the photos [pixels]
    state: State = "queued"
    sentence: str = ""  # why it failed
    made: float = 0.0  # when it was asked for [seconds since 1970]

    @property
    def prompt(self) -> str:
        return str(self.settings.get("prompt", ""))

    @property
    def is_active(self) -> bool:
        return self.state in ("queued", "running")


_JOB = TypeAdapter(AppJob)
_NAMING = threading.Lock()
"""Sets of photos and jobs take their names from one stock, each under this lock."""


class JobsFolder:
    """Reads and writes the jobs folder; nothing of it is kept in memory."""

    def __init__(self, root: str | Path) -> None:
        self.root = expanded(root).resolve()
        self.private = _no_link(self.root / PRIVATE)
        try:
            self.private.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{self.root}: cannot be the jobs folder ({error.strerror}); give --jobs another."
            ) from None

    # ---- sets of photos and runs ----

    def path(self, name: str) -> Path:
        """Folder of a set of photos or a run; raises InputError for what is no name of one."""
        if _is_name(name) and (self.root / name).is_dir():
            return self.root / name
        raise InputError(f"{str(name)[:60]!r}: no photos and no run of that name here.")

    def own(self, name: str) -> Path:
        """The folder of a set of photos that is written to; raises InputError for one elsewhere."""
        _no_link(self.path(name) / "images")
        return _no_link(self.path(name))

    def splat(self, name: str) -> tuple[Path, Path] | None:
        """The file and the cameras of a scene that was dropped, or of a run that edited one."""
        path = self.path(name)
        if self.is_run(name):
            return RunFolder(path).given_scene()
        cameras = path / SPLAT / "cameras.json"
        files = [one for one in sorted((path / SPLAT).glob("*")) if one != cameras]
        if not files or not cameras.is_file():
            return None
        return _no_link(files[0]), cameras

    def is_run(self, name: str) -> bool:
        return (self.root / name / "run.json").is_file()

    def photos(self, name: str) -> dict[str, Path]:
        """The photos of a set, or those that a run used, by the names of their views."""
        return self.images(name, "inputs" if self.is_run(name) else "images")

    def images(self, name: str, kind: str) -> dict[str, Path]:
        """The images of one of `KINDS`, by the names of their views."""
        place = self.beside(name) if kind == PREVIEW else self.path(name)
        try:
            files = find_photos([place / kind])
        except InputError:  # there are none yet
            return {}
        return dict(zip(unique_names([file.stem for file in files]), files))

    def new_scene(self, wanted: str) -> str:
        """Make an empty set of photos, called as wanted as far as that can be a name."""
        with _NAMING:
            # A job that waits has no folder yet, but its name.
            taken = [path.name for path in self.root.iterdir()]
            taken += [path.stem for path in self.private.glob("*.json")]
            taken += [path.name for path in self.private.iterdir() if path.is_dir()]
            taken += [path.name for path in (self.root / DELETED).glob("*")]
            wanted = wanted.strip(". ") or "scene"
            name = unique_names([*sorted(set(taken)), wanted])[-1]
            (self.root / name / "images").mkdir(parents=True)
        return name

    def scenes(self) -> list[str]:
        """All sets of photos, and runs of the command line, newest first."""
        names = {job.scene for job in self.jobs()}
        names |= {path.parent.name for path in self.root.glob("*/images")}
        there = [self.root / name for name in names if (self.root / name).is_dir()]
        there.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        return [path.name for path in there]

    def delete(self, scene: str) -> None:
        """Move a scene and all that was made of it to `.deleted`: nothing of it is lost.

        Raises InputError where an edit of it waits or is being made.
        """
        there = _no_link(self.root / DELETED)
        with _NAMING:
            self.own(scene)
            jobs = self.history(scene)
            if any(job.is_active for job in jobs):
                raise InputError(
                    f"{scene}: an edit of it is still being made; cancel it first."
                )
            (there / PRIVATE).mkdir(parents=True, exist_ok=True)
            for name in dict.fromkeys([*(job.name for job in jobs), scene]):
                beside = (f"{name}.json", f"{name}.log", name)
                for path in (name, *(f"{PRIVATE}/{one}" for one in beside)):
                    with suppress(FileNotFoundError):
                        (self.root / path).rename(there / path)

    # ---- jobs ----

    def new_job(
        self,
        job: AppJob,
        masks: Iterable[Float[Tensor, "height width"]] = (),
        known: Path | None = None,
        drawn: Path | None = None,
    ) -> AppJob:
        """Queue a job, after writing its masks, under a name that is free; its own is ignored.

        `drawn` is the file of what is drawn over the scene. `known` is a folder with what was read
        from the photos already; beside masks a run finds it.
        """
        name = self._reserved(job.scene[:80])
        count = 0
        for mask in masks:
            file = self.beside(name) / f"{count:03}.png"
            save_image(mask.expand(3, -1, -1), file)
            count += 1
        if count and known is not None and known.is_dir():
            shutil.copytree(known, self.beside(name) / known.name)
        if drawn is not None:
            shutil.copyfile(drawn, self.beside(name) / ASKED)
        job = replace(
            job, name=name, masks=count, drawn=drawn is not None, made=time.time()
        )
        self.write(job)
        return job

    def _reserved(self, stem: str) -> str:
        """A free name STEM-N, taken by making its folder."""
        numbers = itertools.count(1)
        while True:
            name = f"{stem}-{next(numbers)}"
            with _NAMING, suppress(FileExistsError):
                roots = (self.root, self.root / DELETED)
                if not any((root / name).exists() for root in roots):
                    (self.private / name).mkdir()
                    return name

    def write(self, job: AppJob) -> None:
        with atomic_write(self._record(job.name)) as partial:
            partial.write_text(json.dumps(asdict(job), indent=1), encoding="utf-8")

    def jobs(self) -> Iterator[AppJob]:
        """Every run that was asked for or that lies there, in the order of asking."""
        runs = {path.parent.name for path in self.root.glob("*/run.json")}
        names = runs | {path.stem for path in self.private.glob("*.json")}
        found = [self._read(name, name in runs) for name in names]
        jobs = [job for job in found if job is not None]
        return iter(sorted(jobs, key=lambda job: (job.made, job.name)))

    def job(self, name: str) -> AppJob:
        """One job; raises InputError where there is none of that name."""
        job = self._read(name, _is_name(name) and self.is_run(name))
        if job is None:
            raise InputError(f"{str(name)[:60]!r}: no run of that name here.")
        return job

    def history(self, scene: str) -> list[AppJob]:
        """The jobs of one scene, in the order of asking."""
        return [job for job in self.jobs() if job.scene == scene]

    def log(self, name: str) -> Path:
        return self.private / f"{name}.log"

    def beside(self, name: str) -> Path:
        """Folder for what belongs to a scene or a job and is no result."""
        folder = _no_link(self.private / name)
        folder.mkdir(exist_ok=True)
        return folder

    def _record(self, name: str) -> Path:
        return self.private / f"{name}.json"

    def _read(self, name: str, is_run: bool) -> AppJob | None:
        """What the record and the run folder say; None where there is neither."""
        if not _is_name(name):
            return None
        job = None
        with suppress(OSError, ValueError, InputError):
            job = _JOB.validate_json(self._record(name).read_bytes())
        if job is None:  # a run of the command line, or a damaged record
            if not is_run:
                return None
            job = AppJob(name, name, made=(self.root / name).stat().st_mtime)
        job = replace(job, name=name)
        if is_run:
            prompt = {"prompt": manifest_of(self.root / name).get("prompt")}
            return replace(job, state="done", settings=job.settings or prompt)
        if job.state == "done":
            job = replace(job, state="failed", sentence="its folder is gone.")
        return job


def _no_link(path: Path) -> Path:
    """The path; raises InputError where it is a link: a stranger's folder may lead elsewhere."""
    if path.is_symlink():
        raise InputError(
            f"{path}: leads out of the jobs folder; nothing is written there."
        )
    return path


def _is_name(name: object) -> bool:
    """Whether it can be the name of a folder of ours."""
    return is_plain_name(name) and not name.startswith(".")


def manifest_of(run: Path) -> dict[str, Any]:
    """Content of a run's run.json; empty where it cannot be read: it may be a stranger's."""
    content = None
    with suppress(OSError, ValueError, RecursionError):
        content = read_json(run / "run.json")
    return content if isinstance(content, dict) else {}


def objects_of(folder: JobsFolder, run: str) -> list[str]:
    """Names of a run's objects; none of what is no run, or says nothing that can be read."""
    found = manifest_of(folder.root / run).get("objects")
    return [str(name) for name in found] if isinstance(found, dict) else []


def tree(history: list[AppJob]) -> list[tuple[int, AppJob]]:
    """(depth, job) with every job below the one that it goes on from, in the order of asking."""
    places: dict[str, tuple[int, ...]] = {}
    for index, job in enumerate(history):
        places[job.name] = (*places.get(job.parent, ()), index)
    ordered = sorted(history, key=lambda job: places[job.name])
    return [(len(places[job.name]) - 1, job) for job in ordered]
