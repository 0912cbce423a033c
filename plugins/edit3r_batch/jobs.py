"""The jobs file: a job a line, all of them read and checked before the first one runs."""

import unicodedata
from codecs import BOM_UTF16_BE, BOM_UTF16_LE, EncodedFile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from edit3r import Registry
from edit3r.contract.errors import Edit3rError, InputError, SettingsError, did_you_mean
from edit3r.contract.reporting import progress
from edit3r.contract.settings import make_settings, merge, of_file
from edit3r.kit.files.names import unique_names
from edit3r.kit.files.text import parse_json
from edit3r.kit.photos.coverage import VIDEO_SUFFIXES
from edit3r.kit.photos.images import find_photos
from edit3r.kit.photos.intrinsics import NO_CAMERAS
from edit3r.kit.provenance import recorded
from edit3r.running import JobInputs, RunConfig, check_components, make_run_config

MAX_BYTES = 1_000_000  # of a line
SHORT = 200  # characters of a prompt that no run refuses
TOLD_EVERY = 200  # lines between two notes of how many are checked
RESERVED = ("results.jsonl", "summary.json", "summary.md")
"""Files beside the jobs' folders."""


class LineInputs(JobInputs):
    """What a line says beside the settings of the run.

    Files are named from the folder of the jobs file.
    """

    id: str = ""
    """name of the job's folder; default: by the line's number"""
    photos: tuple[str, ...] = Field(min_length=1)
    """photos, folders or videos"""


KEYS = [name for name in LineInputs.model_fields if name != "earlier"]
"""Keys of a line beside those of a run; a batch begins with photos."""


@dataclass(frozen=True)
class BatchJob:
    """One run of a batch. The files in `inputs` are absolute."""

    id: str
    line: int
    inputs: JobInputs
    settings: Mapping[str, Any]  # of the run, as a configuration file holds them
    # all that the results depend on, as JSON data without secrets
    record: Mapping[str, Any]

    @property
    def editor(self) -> str:
        """The editor with its settings: jobs of one share what a worker has loaded."""
        return repr(self.settings.get("editor"))


def read_jobs(
    file: Path, defaults: Mapping[str, Any], registry: Registry, trusted: bool
) -> dict[str, BatchJob]:
    """Return the jobs by id, in their order; `defaults` are settings that a job may override.

    Raises InputError, with the number of the line, for the first job that could not run.
    """
    found: dict[str, BatchJob] = {}
    line_of: dict[str, int] = {}
    checked: set[str] = set()
    folder = file.resolve().parent
    total = sum(1 for _ in _lines(file))
    for count, (number, line) in enumerate(_lines(file)):
        if count % TOLD_EVERY == 0:
            progress("check jobs", count, total)
        try:
            content = _content(line)
            if not trusted:
                content = of_file(content)
            job = _job(content, number, folder, defaults)
            _check(job, registry, checked)
            # A disk may take names that differ only in case for one.
            same = unicodedata.normalize("NFC", job.id).casefold()
            first = line_of.setdefault(same, number)
            if first != number:
                raise InputError(
                    f"the id {job.id!r} is that of line {first} too; each job needs its own."
                )
        except Edit3rError as error:
            raise InputError(f"{file}, line {number}: {error}") from None
        found[job.id] = job
    if not found:
        raise InputError(
            f"{file}: no jobs in it; expected lines such as "
            '{"photos": ["a.jpg", "b.jpg"], "prompt": ""}.'
        )
    return found


def _lines(file: Path) -> Iterator[tuple[int, bytes]]:
    """Number and content of each line that is not blank."""
    if not file.is_file():
        raise InputError(f"{file}: no such file of jobs.")
    with file.open("rb") as stream:
        is_utf_16 = stream.peek(2)[:2] in (BOM_UTF16_LE, BOM_UTF16_BE)
        # PowerShell writes UTF-16
        source = EncodedFile(stream, "utf-8", "utf-16") if is_utf_16 else stream
        lines = iter(lambda: source.readline(MAX_BYTES + 1), b"")
        for number, line in enumerate(lines, start=1):
            if len(line) > MAX_BYTES:
                raise InputError(
                    f"{file}, line {number}: longer than {MAX_BYTES:,} bytes; expected one job "
                    "a line."
                )
            if line.strip():
                yield number, line


def _job(
    content: Mapping[str, Any], number: int, folder: Path, defaults: Mapping[str, Any]
) -> BatchJob:
    words = {key: value for key, value in content.items() if key in KEYS}
    settings = {key: value for key, value in content.items() if key not in KEYS}
    inputs = make_settings(LineInputs, words, "job")
    name = inputs.id or f"job-{number:06d}"
    _check_name(name)
    settings = merge(defaults, settings)
    said = {k: v for k, v in inputs.model_dump(exclude={"id", "earlier"}).items() if v}
    record = recorded({**settings, **said})
    return BatchJob(name, number, _absolute(inputs, folder), settings, record)


def _content(line: bytes) -> dict[str, Any]:
    """The object that a line holds, with keys that are known."""
    try:
        content = parse_json(line)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({error}).") from None
    if not isinstance(content, dict):
        raise InputError(f"expected an object in braces, got {type(content).__name__}.")
    known = [*KEYS, *RunConfig.model_fields]
    for key in content:
        if key not in known:
            hint = did_you_mean(key, known)
            listed = ", ".join(known)
            raise SettingsError(
                f"{key[:60]!r} is no key of a job.{hint} Keys: {listed}."
            )
    return content


def _check_name(name: str) -> None:
    safe = unique_names([name])[0]
    if name == safe and name not in RESERVED:
        return
    other = f"; {safe!r} would do" if name != safe else ""
    raise InputError(
        f"the id {name[:120]!r} cannot be the name of a folder here{other}."
    )


def _absolute(inputs: JobInputs, folder: Path) -> JobInputs:
    changes: dict[str, Any] = {
        "photos": tuple(str(folder / name) for name in inputs.photos),
        "mask": tuple(str(folder / name) for name in inputs.mask),
    }
    if inputs.cameras not in (None, "", NO_CAMERAS):
        changes["cameras"] = str(folder / inputs.cameras)
    return inputs.model_copy(update=changes)


def _check(job: BatchJob, registry: Registry, checked: set[str]) -> None:
    """Raise what is wrong with the job's settings and files.

    `checked` are photos that are there, and choices of components that were right.
    """
    given = job.inputs.cameras
    cameras = [given] if given not in (None, "", NO_CAMERAS) else []
    try:
        for path in map(Path, job.inputs.photos):
            is_video = path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()
            # Frames of a video are taken when the job runs; many jobs have the same photos.
            if not is_video and str(path) not in checked:
                find_photos([path])
                checked.add(str(path))
        for name in (*job.inputs.mask, *cameras):
            if not Path(name).is_file():
                raise InputError(f"{name}: no such file.")
    except OSError as error:
        raise InputError(f"{str(error.filename)[:200]}: {error.strerror}.") from None
    settings = dict(job.settings)
    words = settings.get("prompt")
    if isinstance(words, str) and len(words) <= SHORT:
        settings["prompt"] = ""  # many jobs differ in their words alone
    if (choices := repr(settings)) not in checked:
        check_components(make_run_config(job.settings), registry)
        checked.add(choices)
