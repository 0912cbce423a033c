"""What a worker does with a job: the run, as `edit3r run` does it, with what the jobs before have
loaded.
"""

import argparse
import errno
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from edit3r.cli.run import read_photos, with_known_poses
from edit3r.config import PartChoice
from edit3r.errors import RunError, as_known
from edit3r.io.atomic import MARKER, atomic_folder
from edit3r.io.coverage import USUAL_FRAMES, frame_origins
from edit3r.io.images import find_photos
from edit3r.pipeline.config import make_run_config
from edit3r.plugins.load import load_plugins
from edit3r.plugins.registry import Registry
from edit3r.reporting import Report, collecting
from edit3r_batch.jobs import Job

RECORD = "job.json"
"""In the folder of each job beside what a run leaves: what was asked for."""


class WarmRegistry(Registry):
    """A registry that keeps the last component it built of each name, with the weights that it
    holds.
    """

    def __init__(self, local_files: tuple[str, ...]) -> None:
        super().__init__(load_plugins(local_files))
        self._kept: dict[tuple[str, str], tuple[Any, Any]] = {}

    def build_choice(
        self, kind: str, choice: PartChoice, parts: Mapping[str, Any] | None = None
    ) -> Any:
        """Return the component that was built last, if it was built from the same settings and
        parts.
        """
        asked = (choice.settings, dict(parts or {}))
        if (kind, choice.name) not in self._kept or self._kept[kind, choice.name][
            0
        ] != asked:
            self._kept.pop(
                (kind, choice.name), None
            )  # first: two sets of weights may not fit
            self._kept[kind, choice.name] = (
                asked,
                super().build_choice(kind, choice, parts),
            )
        return self._kept[kind, choice.name][1]


@dataclass(frozen=True)
class SceneRunner:
    """Turns a job into its folder and a row about it. It is pickled to each worker, where what it
    has built stays.
    """

    out: Path
    plugins: tuple[str, ...] = ()
    overwrite: bool = False

    @cached_property
    def registry(self) -> Registry:
        return WarmRegistry(self.plugins)

    def __call__(self, job: Job) -> dict[str, Any]:
        """Do the job, unless its folder is there, and return its row; a failure is a row too, with
        its sentence.
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

    def _run(self, job: Job, folder: Path) -> None:
        from edit3r.pipeline import steps as pipeline
        from edit3r.pipeline import write as results

        report, wish, paths = Report(), job.wish, []
        marks = {key: list(getattr(wish, key)) for key in ("point", "not_point", "box")}
        marks |= {
            "images": True,
            "earlier": None,
            "mask": [job.path(name) for name in wish.mask],
        }
        cameras = job.path(wish.cameras) if wish.cameras else None
        try:
            with collecting(report), report.stage("read photos"):
                most = max(USUAL_FRAMES, int(job.settings.get("views") or 0))
                paths = find_photos([job.path(name) for name in wish.photos], most)
                config = make_run_config(job.settings, photos=len(paths))
                photos, masks, hashes = read_photos(
                    paths, config, cameras, argparse.Namespace(**marks), self.registry
                )
                if cameras or wish.refine_poses:
                    config = with_known_poses(
                        config, photos.views, self.registry, wish.refine_poses
                    )
            result = pipeline.run(
                photos.views, config, masks=masks, registry=self.registry, report=report
            )
            results.write(
                folder, replace(result, records=photos.photos, mask_files=hashes)
            )
        finally:
            for taken in {
                path.parent for path in paths if path in frame_origins
            }:  # frames of a video
                shutil.rmtree(taken, ignore_errors=True)
        (folder / RECORD).write_text(
            json.dumps(job.record, indent=1, ensure_ascii=False) + "\n",
            encoding="utf-8",
        )


def record_of(folder: Path) -> dict[str, Any]:
    """The record of the job that a finished folder is of; empty for a folder that is not there or
    that no job made.
    """
    try:
        record = (
            json.loads((folder / RECORD).read_text(encoding="utf-8"))
            if (folder / MARKER).is_file()
            else {}
        )
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def row_of(folder: Path) -> dict[str, Any]:
    """What a finished folder says about its run. It is the same whoever did the job."""
    try:
        manifest = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        verdict, gaussians = manifest["verdict"], manifest["gaussians"]
        shown = [psnr for psnr in verdict["input_psnr"] if psnr is not None]
        row = {
            "verdict": verdict["label"],
            "reason": verdict["reason"],
            "psnr": sum(shown) / len(shown),
        }
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
    return {**row, "gaussians": gaussians, "warnings": len(manifest["warnings"])}
