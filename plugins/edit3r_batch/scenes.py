"""What a worker does with a job: the run, with what the jobs before have loaded."""

import errno
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, TypeAdapter
from typing_extensions import Required, TypedDict

from edit3r import Registry
from edit3r.contract.errors import RunError, as_known
from edit3r.contract.settings import PartChoice
from edit3r.contract.verdicts import Label
from edit3r.kit.files.atomic import MARKER, atomic_folder
from edit3r.kit.files.text import read_json
from edit3r.loading import load_plugins
from edit3r_batch.jobs import BatchJob

NO_EDIT = ""  # label where nothing was to be edited
RECORD = "job.json"
"""In the folder of each job beside what a run leaves: what was asked for."""


class WarmRegistry(Registry):
    """Keeps the last component it built of each name, with the weights that it holds."""

    def __init__(self, local_files: tuple[str, ...]) -> None:
        super().__init__(load_plugins(local_files))
        self._kept: dict[tuple[str, str], tuple[Any, Any]] = {}

    def build_choice(
        self, kind: str, choice: PartChoice, parts: Mapping[str, Any] | None = None
    ) -> Any:
        """Return the component that was built last, if its settings and parts were the same."""
        key = (kind, choice.name)
        asked = (choice.settings, dict(parts or {}))
        if key not in self._kept or self._kept[key][0] != asked:
            self._kept.pop(key, None)  # first: two sets of weights may not fit
            self._kept[key] = asked, super().build_choice(kind, choice, parts)
        return self._kept[key][1]


@dataclass(frozen=True)
class SceneRunner:
    """Turns a job into its folder and a row about it.

    It is pickled to each worker, where what it has built stays.
    """

    out: Path
    plugins: tuple[str, ...]
    overwrite: bool

    @cached_property
    def registry(self) -> Registry:
        return WarmRegistry(self.plugins)

    def __call__(self, job: BatchJob) -> dict[str, Any]:
        """Do the job, unless its folder is there, and return its row.

        A failure is a row too, with its sentence.
        """
        folder = self.out / job.id
        try:
            if record_of(folder) != job.record:
                with atomic_folder(folder, self.overwrite) as partial:
                    self._run(job, partial)
            return row_of(folder)
        except Exception as error:
            if isinstance(error, OSError) and error.errno in (
                errno.ENOSPC,
                errno.EDQUOT,
            ):
                raise as_known(error) from None  # the next job would fail as well
            return {"failure": " ".join(str(as_known(error)).split())}

    def _run(self, job: BatchJob, folder: Path) -> None:
        from edit3r.running import job_from, run, write_result

        result = run(job_from(job.inputs, job.settings), self.registry)
        write_result(folder, result)
        text = json.dumps(job.record, indent=1, ensure_ascii=False)
        (folder / RECORD).write_text(text + "\n", encoding="utf-8")


def record_of(folder: Path) -> dict[str, Any]:
    """The record of the job that made a finished folder; empty where there is none."""
    try:
        if not (folder / MARKER).is_file():
            return {}
        record = read_json(folder / RECORD)
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


class _Row(TypedDict, total=False):
    __pydantic_config__ = ConfigDict(strict=True, allow_inf_nan=False)  # type: ignore[misc]

    verdict: Required[Label]
    reason: Required[str]
    selected: str
    edit: Literal["good", "doubtful", ""]
    edit_reason: str
    psnr: float
    gaussians: int


_ROWS = TypeAdapter(_Row)


def check_row(row: dict[str, Any]) -> None:
    """Raise ValueError unless this can be shown as the row of a finished job."""
    _ROWS.validate_python(row)


def _selected(verdict: dict[str, Any] | None) -> str:
    """What was selected, in a word, and how confidently; "" where nothing was looked for."""
    if verdict is None:
        return ""
    label, confidence = verdict["label"], verdict["confidence"]
    return label if confidence is None else f"{label} {confidence:.0%}"


def row_of(folder: Path) -> dict[str, Any]:
    """What a finished folder says about its run. It is the same whoever did the job."""
    try:
        manifest = read_json(folder / "run.json")
        verdict = manifest["verdict"]
        shown = [psnr for psnr in verdict["input_psnr"] if psnr is not None]
        edit = manifest["edit_verdict"] or {"label": NO_EDIT, "reason": ""}
        row = {
            "verdict": verdict["label"],
            "reason": verdict["reason"],
            "selected": _selected(manifest["selection_verdict"]),
            "edit": edit["label"],
            "edit_reason": edit["reason"],
            "psnr": sum(shown) / len(shown),
            "gaussians": manifest["gaussians"],
            "warnings": len(manifest["warnings"]),
        }
        check_row(row)
        return row
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        ZeroDivisionError,
        RecursionError,
    ):
        raise RunError(
            f"{folder}: its run.json cannot be read; delete the folder to do the job again."
        ) from None
