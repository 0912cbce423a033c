"""What many scenes cost, and whether a batch that is killed goes on.

python benchmarks/batch.py cost|kills --help
"""

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from harness import run_benchmark
from PIL import Image

from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.workers import Workers, read_rows, run_resumable, write_rows

# ---- cost ----

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


def cost() -> None:
    """What small scenes cost as a batch and as single commands: half of the commands, the batch,
    the other half.

        python benchmarks/batch.py cost DIR --jobs 40 --commands 12 --workers 2

    The scenes are crops of the packaged pair, each with a colour of its own. Processor seconds of
    all processes and wall seconds for each scene; commands run as many at a time as the batch has
    workers, each with one thread.
    """
    parser = argparse.ArgumentParser(
        description=cost.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
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


# ---- kills ----

FAILS, DIES = 0.01, 0.001  # shares of the jobs
WORK = 0.002  # seconds of a fake job, so that kills come in the middle of some


@dataclass(frozen=True)
class FakeRunner:
    """What `edit3r batch` does with a job, without the scene."""

    out: Path
    start: (
        int  # of the batch: a worker that died of a job is not bound to die of it again
    )

    def __call__(self, key: str) -> dict:
        place = self.out / "done" / key[-2:] / key
        if place.exists():  # finished, but killed before its row was written
            return {"verdict": "good"}
        chance = random.Random(f"{key} {self.start}").random()
        if chance < DIES:
            os.kill(os.getpid(), signal.SIGKILL)
        if random.Random(key).random() < FAILS:
            return {"failure": "the photos do not show the same scene."}
        with (self.out / "begun").open("a") as log:
            log.write(f"{key}\n")
        time.sleep(WORK)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch(exist_ok=False)  # a job that is done twice ends the batch
        return {"verdict": "good"}


def serve(out: Path, count: int, workers: int, start: int) -> None:
    """One call of the batch: what failed is tried once more, as `edit3r batch` does."""
    rows = read_rows(out / "rows.jsonl")
    if any("died" in row.get("failure", "") for row in rows.values()):
        write_rows(
            out / "rows.jsonl",
            [row for row in rows.values() if "died" not in row.get("failure", "")],
        )
    jobs = {f"job-{number:06d}": f"job-{number:06d}" for number in range(count)}
    runner, staff = FakeRunner(out, start), Workers(workers, may_die=True)
    run_resumable(jobs, runner, out / "rows.jsonl", workers=staff)


def supervise(out: Path, count: int, workers: int, kills: int) -> None:
    """Start the batch again and again, killing it `kills` times, until every job has a row that is
    no death.
    """
    began, start, deaths = time.monotonic(), 0, 0
    # rows after which to kill
    places = sorted(random.Random(0).sample(range(count * 9 // 10), kills))
    while True:
        command = [
            sys.executable,
            __file__,
            "kills",
            str(out),
            "--serve",
            str(start),
            "--jobs",
            str(count),
        ]
        child = subprocess.Popen([*command, "--workers", str(workers)])
        while child.poll() is None and (
            not places or _lines(out / "rows.jsonl") < places[0]
        ):
            time.sleep(0.2)
        if child.poll() is None and places:
            child.send_signal(signal.SIGKILL)
            places.pop(0)
        child.wait()
        start += 1
        rows = read_rows(out / "rows.jsonl")
        died = sum("died" in row.get("failure", "") for row in rows.values())
        deaths += died
        if child.returncode == 0 and not died:
            break
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = len((out / "begun").read_text().split())
    done = {path.name for path in (out / "done").glob("*/*")}
    failed = {key for key, row in rows.items() if "failure" in row}
    killed = kills - len(places)
    print(
        f"{count:,} jobs, {workers} workers; batch killed {killed} times, {deaths} workers died, "
        f"{start} starts"
    )
    print(
        f"rows {len(rows):,}: done {len(done):,}, failed {len(failed):,}; begun and not ended "
        f"{begun - len(done):,}"
    )
    print(
        f"processor {used.ru_utime + used.ru_stime:.0f} s, wall {time.monotonic() - began:.0f} s"
    )
    assert len(rows) == count and len(done) + len(failed) == count and not done & failed


def folders(out: Path) -> None:
    """Processor time of one folder that appears whole, beside so many."""
    made = 0
    for count in (1_000, 10_000, 100_000):
        (out / "folders").mkdir(exist_ok=True)
        for made in range(made, count):  # noqa: B020
            (out / "folders" / f"job-{made:06d}").mkdir(exist_ok=True)
        start = time.process_time()
        for number in range(10):
            with atomic_folder(out / "folders" / f"new-{count}-{number}") as folder:
                (folder / "run.json").write_text("{}")
        print(
            f"a folder beside {count:,}: {100 * (time.process_time() - start):.1f} ms"
        )


def _lines(path: Path) -> int:
    """How many rows the file has, by its size: they are of about one length."""
    return path.stat().st_size // 42 if path.exists() else 0


def kills() -> None:
    """The resumable runner with 100,000 fake jobs, of which some fail, some kill their worker, and
    some are in the middle when the whole batch is killed.

        python benchmarks/batch.py kills DIR --jobs 100000 --workers 2 --kills 20

    A fake job leaves a file, as a real one leaves its folder; one that is there already would end
    the batch. At the end every job must have a row, and a file unless it failed. Also measured:
    what a folder that appears whole costs beside 1,000, 10,000 and 100,000 others. Processor
    seconds, since the machine may do other things.
    """
    parser = argparse.ArgumentParser(
        description=kills.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="an empty folder")
    parser.add_argument("--jobs", type=int, default=100_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--serve", type=int, default=None, help=argparse.SUPPRESS)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    if args.serve is not None:
        return serve(args.out, args.jobs, args.workers, args.serve)
    supervise(args.out, args.jobs, args.workers, args.kills)
    folders(args.out)


if __name__ == "__main__":
    run_benchmark(cost, kills)
