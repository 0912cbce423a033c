"""The jobs file: a job a line, all of them read and checked before the first one runs."""

import json
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from edit3r.cli.run import check_names
from edit3r.config import Settings, make_settings, merge
from edit3r.errors import Edit3rError, InputError, SettingsError, suggest
from edit3r.io.coverage import USUAL_FRAMES, VIDEO_SUFFIXES
from edit3r.io.images import find_photos, unique_names
from edit3r.io.run_folder import recorded
from edit3r.pipeline.config import PART_KEYS, RunConfig, make_run_config
from edit3r.plugins.registry import Registry

MOST_BYTES = 1_000_000  # of a line
RESERVED = (
    "results.jsonl",
    "summary.json",
    "summary.md",
)  # files beside the jobs' folders


class Wish(Settings):
    """What a line says beside the settings of the run. Files are named from the folder of the jobs
    file.
    """

    id: str = Field(
        "", description="name of the job's folder; default: by the number of the line"
    )
    photos: tuple[str, ...] = Field(
        min_length=1, description="photos, folders or videos"
    )
    cameras: str | None = Field(None, description="file with the photos' cameras")
    refine_poses: bool = Field(
        False,
        description="let the poses of `cameras` move to where the photos want them",
    )
    mask: tuple[str, ...] = Field(
        (), description="masks, one for each photo or for one"
    )
    point: tuple[str, ...] = Field((), description="points on the object, [N:]X,Y")
    not_point: tuple[str, ...] = Field(
        (), description="points on what is not the object"
    )
    box: tuple[str, ...] = Field((), description="boxes around the object, [N:]X,Y,W,H")

    @field_validator("photos", "mask", "point", "not_point", "box", mode="before")
    @classmethod
    def _one_is_a_list(cls, value: Any) -> Any:
        return [value] if isinstance(value, str) else value


@dataclass(frozen=True)
class Job:
    """One run: what was asked for, and where the jobs file lies that its files are named from."""

    id: str
    line: int
    folder: Path
    wish: Wish
    settings: Mapping[str, Any]  # of the run, as a configuration file holds them

    def path(self, name: str) -> str:
        return str(self.folder / name)

    @property
    def record(self) -> dict[str, Any]:
        """All that the results depend on, as JSON data without secrets; equal for equal jobs."""
        said = {
            key: value
            for key, value in self.wish.model_dump(exclude={"id"}).items()
            if value
        }
        return recorded({**self.settings, **said})


def read_jobs(
    file: Path, defaults: Mapping[str, Any], registry: Registry
) -> dict[str, Job]:
    """Return the jobs by id, in their order; `defaults` are settings of jobs that do not say
    otherwise.

    Raises InputError, with the number of the line, for the first job that could not run.
    """
    found: dict[str, Job] = {}
    same: dict[str, int] = {}
    checked: set[str] = set()
    for number, line in _lines(file):
        try:
            job = _job(line, number, file.resolve().parent, defaults)
            _check(job, registry, checked)
            first = same.setdefault(
                unicodedata.normalize("NFC", job.id).casefold(), number
            )
            if first != number:
                raise InputError(
                    f"the id {job.id!r} is that of line {first} too; each job needs its own."
                )
        except Edit3rError as error:
            raise InputError(f"{file}, line {number}: {error}") from None
        found[job.id] = job
    if not found:
        raise InputError(
            f'{file}: no jobs in it; expected lines such as {{"photos": ["a.jpg", "b.jpg"], '
            '"prompt": ""}.'
        )
    return found


def _lines(file: Path) -> Iterator[tuple[int, bytes]]:
    """Number and content of each line that is not blank."""
    if not file.is_file():
        raise InputError(f"{file}: no such file of jobs.")
    with file.open("rb") as stream:
        for number, line in enumerate(
            iter(lambda: stream.readline(MOST_BYTES + 1), b""), start=1
        ):
            if len(line) > MOST_BYTES:
                raise InputError(
                    f"{file}, line {number}: longer than {MOST_BYTES:,} bytes; expected one job "
                    "a line."
                )
            if line.strip():
                yield number, line


def _job(line: bytes, number: int, folder: Path, defaults: Mapping[str, Any]) -> Job:
    try:
        content = json.loads(line.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({error}).") from None
    if not isinstance(content, dict):
        raise InputError(f"expected an object in braces, got {type(content).__name__}.")
    known = [*Wish.model_fields, *RunConfig.model_fields]
    for key in content:
        if key not in known:
            raise SettingsError(
                f"{key[:60]!r} is no key of a job.{suggest(key, known)} Keys: {', '.join(known)}."
            )
    wish = make_settings(
        Wish,
        {key: value for key, value in content.items() if key in Wish.model_fields},
        "job",
    )
    name = wish.id or f"job-{number:06d}"
    safe = unique_names([name])[0]
    if name != safe or name in RESERVED:
        other = f"; {safe!r} would do" if name != safe else ""
        raise InputError(
            f"the id {name[:120]!r} cannot be the name of a folder here{other}."
        )
    settings = {
        key: value for key, value in content.items() if key not in Wish.model_fields
    }
    return Job(name, number, folder, wish, merge(defaults, settings))


def _check(job: Job, registry: Registry, checked: set[str]) -> None:
    """Raise what is wrong with the job's settings and files; `checked` are choices of components
    that were right.
    """
    count = 0
    for path in map(Path, map(job.path, job.wish.photos)):
        try:
            is_video = path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()
            count += USUAL_FRAMES if is_video else len(find_photos([path]))
            for other in (*job.wish.mask, *filter(None, [job.wish.cameras])):
                if not Path(job.path(other)).is_file():
                    raise InputError(f"{other}: no such file.")
        except OSError as error:
            raise InputError(f"{str(path)[:200]}: {error.strerror}.") from None
    config = make_run_config(job.settings, photos=count)
    choices = repr(
        (*(getattr(config, kind) for kind in PART_KEYS), *config.all_refiners())
    )
    if choices not in checked:
        check_names(registry, config)
        checked.add(choices)
