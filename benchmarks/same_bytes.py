"""Does the same seed give the same bytes? Runs `edit3r run` in 24 fresh processes, each with other
numbers of cores and threads.

    python benchmarks/same_bytes.py [-- OPTIONS OF edit3r run]

A fresh process matters: what differs is often only the first call of a library in it. Prints how
many different scene.ply there were (sha256), then the same for every other file of the runs, in
the order in which they are made: the first that differs says which stage to look at. Exit code 1
where there was more than one scene.
"""

import argparse
import collections
import hashlib
import itertools
import os
import subprocess
import sys
import tempfile
from pathlib import Path

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


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
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
    sys.exit(main())
