"""What export formats cost and lose, and whether the same seed gives the same bytes.

python benchmarks/files.py formats|same-bytes --help
"""

import argparse
import collections
import hashlib
import itertools
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from harness import Row, run_benchmark

from edit3r import build
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Gaussians
from edit3r.kit.photos.camera_files import read_scene_cameras
from edit3r.kit.rendering import render_each
from edit3r.kit.scenes.reading import load_scene

# ---- formats ----

FORMATS = ("spz", "spz4", "sog", "splat", "compressed-ply", "glb", "ply")


def formats(*, folder: Path | None = None) -> Iterator[Row]:
    """What each export format costs and loses, of the run in a folder or of the packaged pair with
    one Gaussian a pixel.

        python benchmarks/files.py formats

    Size, CPU time, and the error after a round trip: of the centres and sizes as medians, in
    standard deviations of the Gaussian itself; of the pictures from the run's cameras, against
    those of scene.ply.
    """
    with tempfile.TemporaryDirectory() as place:
        scratch = Path(place)
        folder = folder or packaged(scratch / "scene")
        scene = load_scene(folder / "scene.ply")
        cameras, _ = read_scene_cameras(folder / "cameras.json")
        rasterizer = build("rasterizer", "auto")
        whole = render_each(rasterizer, scene, cameras, "").images.clamp(0, 1)
        for form in FORMATS:
            writer = build("writer", form)
            file, start = scratch / writer.offer.component.file_name(), _cpu()
            writer.write(file, SceneToWrite(scene))
            spent = _cpu() - start
            back = load_scene(file)
            picture = render_each(rasterizer, back, cameras, "").images.clamp(0, 1)
            error = float((picture - whole).square().mean())
            centres, sizes = _errors(scene, back)
            yield {
                "format": form,
                "MB": (file.stat().st_size / 1e6, ".1f"),
                "CPU s": (spent, ".1f"),
                "centres": (centres, ".2%"),
                "sizes": (sizes, ".2%"),
                "images": f"{-10 * np.log10(error):.1f} dB" if error else "equal",
            }


def _cpu() -> float:
    return sum(
        sum(resource.getrusage(who)[:2])
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )


def _errors(scene: Gaussians, back: Gaussians) -> tuple[float, float]:
    """Median errors of the centres and sizes, relative to the size; formats sort as they like, so
    by nearest centre.
    """
    from scipy.spatial import cKDTree

    gaps, index = cKDTree(back.means[0]).query(scene.means[0])
    size, found = (g.scales[0].double().mean(-1).numpy() for g in (scene, back))
    return float(np.median(gaps / size)), float(
        np.median(np.abs(found[index] / size - 1))
    )


def packaged(folder: Path) -> Path:
    """The folder of a run of the packaged pair with one Gaussian a pixel."""
    every = ["--gaussians", "all", "--refine", "0", "--grid", "1"]
    command = [sys.executable, "-m", "edit3r", "run", *every, "--quiet", "--out"]
    subprocess.run([*command, folder], check=True)
    return folder


# ---- same_bytes ----

CORES = (1, 2)
THREADS = (1, 2, 3, 4)  # of OpenMP, which PyTorch uses
LIBRARIES = ((1, 1), (2, 2), (4, 1))  # threads of numba and of OpenCV
WAYS = tuple(itertools.product(CORES, THREADS, LIBRARIES))
TIMED = ("run.json", ".edit3r-run")  # hold seconds and dates, which differ


def digests(
    folder: Path, cores: int, threads: int, numba: int, opencv: int, options: list[str]
) -> dict[str, str]:
    """sha256 of each file of one run, in the order in which they were written."""
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": str(threads),
        "NUMBA_NUM_THREADS": str(numba),
        "OPENCV_FOR_THREADS_NUM": str(opencv),
    }
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    subprocess.run(
        [sys.executable, "-m", "edit3r", "run", "--quiet", "--out", folder, *options],
        env=environment,
        preexec_fn=lambda: os.sched_setaffinity(0, allowed),
        check=True,
    )
    files = [path for path in folder.rglob("*") if path.is_file()]
    files.sort(key=lambda path: path.stat().st_mtime_ns)
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(
            path.read_bytes()
        ).hexdigest()
        for path in files
        if path.name not in TIMED
    }


def same_bytes() -> int:
    """Does the same seed give the same bytes? Runs `edit3r run` in 24 fresh processes, each with
    other numbers of cores and threads.

        python benchmarks/files.py same-bytes [-- OPTIONS OF edit3r run]

    A fresh process matters: what differs is often only the first call of a library in it. Prints
    how many different scene.ply there were (sha256), then the same for every other file of the
    runs, in the order in which they are made: the first that differs says which stage to look at.
    Exit code 1 where there was more than one scene.
    """
    parser = argparse.ArgumentParser(
        description=same_bytes.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("options", nargs="*", help="of edit3r run, after --")
    options = parser.parse_args().options
    answers: dict[str, collections.Counter] = collections.defaultdict(
        collections.Counter
    )
    for way in WAYS:
        with tempfile.TemporaryDirectory() as folder:
            found = digests(Path(folder) / "run", *way[:2], *way[2], options)
        for file, digest in found.items():
            answers[file][digest] += 1
        cores, threads, (numba, opencv) = way
        print(
            f"{cores} cores, threads: {threads} OpenMP, {numba} numba, {opencv} OpenCV: "
            f"{found['scene.ply']}",
            flush=True,
        )
    scenes = answers.pop("scene.ply")
    print(f"scene.ply: {len(scenes)} different in {len(WAYS)} processes")
    for file, different in answers.items():
        print(f"{file}: {len(different)} different {sorted(different.values())}")
    return int(len(scenes) > 1)


if __name__ == "__main__":
    run_benchmark(formats, same_bytes)
