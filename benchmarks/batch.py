"""What small scenes cost as a batch and as single commands: half of the commands, the batch, the
other half.

    python benchmarks/batch.py DIR --jobs 40 --commands 12 --workers 2

The scenes are crops of the packaged pair, each with a colour of its own. Processor seconds of all
processes and wall seconds for each scene; commands run as many at a time as the batch has workers,
each with one thread.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from PIL import Image

from edit3r.kit.photos.images import packaged_pair

COLOURS = ("red", "blue", "green", "yellow", "orange", "purple", "pink", "teal")
PROGRAM = [sys.executable, "-m", "edit3r"]


def make_jobs(folder: Path, count: int, size: int, frames: int) -> list[dict]:
    jobs = []
    for number in range(count):
        left, top = 20 * (number % 6), 12 * (number // 6 % 5)
        photos = [f"{number:03d}-{side}.png" for side in ("left", "right")]
        for name, file in zip(photos, packaged_pair()[0]):
            picture = Image.open(file)
            box = (left, top, left + picture.width - 100, top + picture.height - 60)
            picture.crop(box).resize(
                (size, size * (box[3] - box[1]) // (box[2] - box[0]))
            ).save(folder / name)
        instruction = {
            "prompt": f"paint it {COLOURS[number % 8]}",
            "size": size,
            "frames": frames,
            "fov": 50,
        }
        jobs.append({"id": f"scene-{number:03d}", "photos": photos, **instruction})
    (folder / "jobs.jsonl").write_text(
        "".join(json.dumps(job) + "\n" for job in jobs), encoding="utf-8"
    )
    return jobs


def command(folder: Path, job: dict) -> None:
    options = [
        "--prompt",
        job["prompt"],
        "--size",
        str(job["size"]),
        "--fov",
        "50",
    ]
    options += ["--frames", str(job["frames"])]
    photos = [str(folder / name) for name in job["photos"]]
    out = str(folder / "single" / job["id"])
    subprocess.run(
        [*PROGRAM, "run", *photos, *options, "--quiet", "--out", out], check=True
    )


def measured(act) -> tuple[float, float]:
    """Processor and wall seconds of what `act` starts."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    act()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (
        after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        time.monotonic() - start,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="an empty folder")
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--commands", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--frames", type=int, default=4)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    os.environ.update({"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"})
    jobs = make_jobs(args.folder, args.jobs, args.size, args.frames)
    command(args.folder, jobs[0])  # compiles what this machine has not compiled yet

    def commands(chosen: list[dict]) -> None:
        with ThreadPoolExecutor(args.workers) as pool:
            list(pool.map(lambda job: command(args.folder, job), chosen))

    def batch() -> None:
        options = [
            "--out",
            str(args.folder / "batch"),
            "--workers",
            str(args.workers),
            "--quiet",
        ]
        subprocess.run(
            [*PROGRAM, "batch", str(args.folder / "jobs.jsonl"), *options], check=True
        )

    half = args.commands // 2
    first = measured(lambda: commands(jobs[:half]))
    together = measured(batch)
    second = measured(lambda: commands(jobs[half : args.commands]))
    singles = [(a + b) / args.commands for a, b in zip(first, second)]
    batched = [seconds / args.jobs for seconds in together]
    runs = [
        json.loads(path.read_text())
        for path in (args.folder / "batch").glob("*/run.json")
    ]
    cpu = sorted(sum(stage["cpu_seconds"] for stage in run["stages"]) for run in runs)
    peak = max(stage["peak_memory_mb"] for run in runs for stage in run["stages"])
    size = sum(
        path.stat().st_size for path in (args.folder / "batch").glob("scene-*/**/*")
    ) / len(runs)
    print(
        f"stages {cpu[0]:.2f} to {cpu[-1]:.2f} processor s, median {cpu[len(cpu) // 2]:.2f}"
    )
    print(f"a worker takes up to {peak:.0f} MB of memory, a folder {size / 1e6:.1f} MB")
    for name, single, one in zip(("processor", "wall"), singles, batched):
        print(
            f"{name}: a command {single:.2f} s, a job of the batch {one:.2f} s: "
            f"{single / one:.2f} times as many"
        )


if __name__ == "__main__":
    main()
