"""Measure every point on every scene, each in a fresh process, and keep what was measured: a sweep can be killed.

`measurements.jsonl` gets one line a point and scene, flushed as it is written. A line counts for a later sweep when its
key is the same: a hash of the point's settings, the scene's pictures and poses, the number of runs, the threads and the
versions of edit3r and torch.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edit3r.io.run_folder import installed_versions
from edit3r.reporting import track
from edit3r_measure.tradeoff.knobs import Point, SweepPlan
from edit3r_measure.tradeoff.scenes import MeasuredScene

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
_SAID = 300  # characters of a dead process's last words that are kept


@dataclass(frozen=True)
class SweepFolder:
    """Where everything about a sweep lies."""

    root: Path

    @property
    def measurements(self) -> Path:
        return self.root / "measurements.jsonl"

    @property
    def scenes(self) -> Path:
        return self.root / "scenes"

    @property
    def table(self) -> Path:
        return self.root / "tradeoff.md"

    @property
    def plot(self) -> Path:
        return self.root / "tradeoff.png"

    def picture(self, key: str) -> Path:
        """The novel view of one measurement."""
        return self.root / "pictures" / f"{key}.png"


@dataclass(frozen=True)
class Effort:
    """How each point is measured."""

    warm_up: int = 1
    repeats: int = 3
    threads: int | None = None  # None: as many as the libraries take by themselves
    seconds: float | None = None  # no measurement starts after that much wall time; None: no limit


def sweep(
    plan: SweepPlan,
    points: Sequence[Point],
    scenes: Sequence[MeasuredScene],
    folder: SweepFolder,
    effort: Effort,
    plugins: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Measurements of all points on all scenes, those of earlier sweeps included; fewer if the time ran out."""
    done = read_measurements(folder.measurements)
    prints = {scene.path: scene.fingerprint() for scene in scenes}
    wanted = {
        measurement_key(point, prints[scene.path], effort): (point, scene) for point in points for scene in scenes
    }
    missing = [key for key in wanted if key not in done]
    start = time.monotonic()
    with folder.measurements.open("a", encoding="utf-8") as file:
        if _is_cut_short(folder.measurements):
            print(file=file)
        for key in track(missing, "measure"):
            if effort.seconds is not None and time.monotonic() - start > effort.seconds:
                break
            point, scene = wanted[key]
            answer = _in_fresh_process(plan, point, scene, folder.picture(key), effort, plugins)
            done[key] = {**_heading(key, point, scene, effort), **answer}
            print(json.dumps(done[key]), file=file, flush=True)
    return [{**done[key], "label": point.label} for key, (point, _) in wanted.items() if key in done]


def read_measurements(path: Path) -> dict[str, dict[str, Any]]:
    """Key to measurement; a line that a kill cut short is left out."""
    found = {}
    for line in _lines(path):
        try:
            measurement = json.loads(line)
        except ValueError:
            continue
        found[measurement["key"]] = measurement
    return found


def measurement_key(point: Point, scene_fingerprint: str, effort: Effort) -> str:
    """The same for measurements that would measure the same thing."""
    versions = installed_versions()
    content = [
        point.settings,
        scene_fingerprint,
        (effort.warm_up, effort.repeats, effort.threads),
        [versions.get(name) for name in ("edit3r", "torch")],
    ]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _is_cut_short(path: Path) -> bool:
    """Whether a kill left the last line without its end."""
    content = path.read_bytes()
    return bool(content) and not content.endswith(b"\n")


def _lines(path: Path) -> Iterator[str]:
    if path.is_file():
        yield from path.read_text(encoding="utf-8").splitlines()


def _heading(key: str, point: Point, scene: MeasuredScene, effort: Effort) -> dict[str, Any]:
    return {
        "key": key,
        "label": point.label,
        "settings": point.settings,
        "scene": scene.name,
        "kind": scene.kind,
        "threads": effort.threads,
        "measured_at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def _in_fresh_process(
    plan: SweepPlan, point: Point, scene: MeasuredScene, picture: Path, effort: Effort, plugins: Sequence[str]
) -> Mapping[str, Any]:
    with tempfile.TemporaryDirectory() as work:
        job, answer = Path(work) / "job.json", Path(work) / "answer.json"
        content = {
            "scene": str(scene.path.resolve()),
            "settings": point.settings,
            "unedited": plan.unedited,
            "edited": plan.edited,
            "perceptual": plan.perceptual,
            "warm_up": effort.warm_up,
            "repeats": effort.repeats,
            "plugins": [str(Path(file).resolve()) for file in plugins],
            "picture": str(picture.resolve()),
            "answer": str(answer),
        }
        job.write_text(json.dumps(content), encoding="utf-8")
        command = [sys.executable, "-m", "edit3r_measure.tradeoff.measure", str(job)]
        ended = subprocess.run(command, env=_environment(effort), capture_output=True, text=True, check=False)
        if answer.is_file():
            return json.loads(answer.read_text(encoding="utf-8"))
    return {"failure": f"the process ended with {ended.returncode}: {' '.join(ended.stderr.split())[-_SAID:]}"}


def _environment(effort: Effort) -> dict[str, str]:
    threads = {} if effort.threads is None else dict.fromkeys(_THREAD_VARIABLES, str(effort.threads))
    return {**os.environ, **threads}
