"""`edit3r batch`: a file of jobs, a folder of runs.

jobs      JOBS.jsonl    ->  jobs, all checked                       (`jobs`)
scenes    job           ->  DIR/ID, an ordinary run folder          (`scenes`), spread by `edit3r.workers`
summary   rows          ->  DIR/summary.json, DIR/summary.md        (`summary`)
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edit3r.command import Command
from edit3r.errors import InputError, RunError, SettingsError

if TYPE_CHECKING:
    from edit3r.workers import Progress
    from edit3r_batch.jobs import Job

RESULTS = "results.jsonl"


class BatchCommand(Command):
    """Run thousands of scenes: each line of the file is a job in JSON, with `photos`, `prompt` and any run setting.

    A batch that was killed is called again and goes on: what is finished stays, what failed is tried once more.
    """

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("jobs", metavar="JOBS.jsonl", help='lines such as {"id": "bike", "photos": ["a.jpg", "b.jpg"], "seed": 1}')
        add("--out", required=True, metavar="DIR", help="folder for the results: one folder of a run for each job")
        add("--workers", type=int, default=1, metavar="N", help="processes (default 1); the results are the same")
        add("--ray", action="store_true", help="spread the workers with Ray instead, here or over RAY_ADDRESS")
        add("--threads", type=int, default=1, metavar="N", help="threads of each worker (default 1)")
        add("--config", metavar="FILE", help="YAML file of run settings, for jobs that do not say otherwise")
        add("--set", action="append", default=[], metavar="KEY=VALUE", help="one such setting, such as size=256")
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--overwrite", action="store_true", help="do jobs again that were done with other settings")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from filelock import FileLock, Timeout

        from edit3r.config import find_config, merge, parse_assignments, read_yaml
        from edit3r.registry import default_registry
        from edit3r.workers import Workers
        from edit3r_batch.jobs import read_jobs

        for option in ("workers", "threads"):
            if getattr(args, option) < 1:
                raise SettingsError(f"--{option}: must be at least 1, got {getattr(args, option)}.")
        plugins = tuple(str(Path(file).resolve()) for file in args.plugin)
        defaults = merge(read_yaml(find_config(args.config)) if args.config else {}, parse_assignments(args.set))
        jobs = read_jobs(Path(args.jobs), defaults, default_registry(plugins))
        out = Path(args.out).expanduser().resolve()
        _check_done(jobs, out, args)
        try:
            out.mkdir(parents=True, exist_ok=True)
            with FileLock(out / ".batch.lock", blocking=False):
                workers = Workers(args.workers, "ray" if args.ray else "processes", args.threads, may_die=True)
                return _run(jobs, out, plugins, workers, args)
        except Timeout:
            raise InputError(f"{out}: another batch is at work there; wait for it, or give --out another.") from None


def _check_done(jobs: "dict[str, Job]", out: Path, args: argparse.Namespace) -> None:
    """Raise InputError where a job's folder holds anything but the same job, and may not be replaced."""
    from edit3r.io.atomic import check_replaceable
    from edit3r_batch.scenes import job_of

    changed = []
    for job in jobs.values():
        folder = out / job.id
        if folder.exists() and (done := job_of(folder)) != job.record:
            check_replaceable(folder, args.overwrite)
            if not args.overwrite:
                changed.append(f"line {job.line}: {job.id!r} is there already, {_difference(done, job)}")
    if changed:
        more = f" (and {len(changed) - 1} more)" if len(changed) > 1 else ""
        raise InputError(f"{args.jobs}, {changed[0]}{more}; give --out another folder, or --overwrite to replace it.")


def _difference(done: dict[str, Any] | None, job: "Job") -> str:
    """In which keys the finished job differs."""
    try:
        before, now = ({**record["wish"], **record["settings"]} for record in (done, job.record))
    except (TypeError, KeyError):
        return "made by another command"
    keys = sorted(key for key in {*before, *now} if before.get(key) != now.get(key))
    return f"done with another {', '.join(keys)}"


def _run(jobs: "dict[str, Job]", out: Path, plugins: tuple[str, ...], workers: Any, args: argparse.Namespace) -> int:
    """Do what is left to do, sum up all jobs, and return the exit code."""
    from edit3r.io.atomic import MARKER, remove_abandoned
    from edit3r.workers import read_rows, run_resumable, write_rows
    from edit3r_batch.scenes import SceneRunner
    from edit3r_batch.summary import counted, table, write_summary

    path, rows = out / RESULTS, read_rows(out / RESULTS, "id")
    stale = [
        id for id, job in jobs.items() if rows.get(id, {}).get("job") != job.digest or not (out / id / MARKER).is_file()
    ]
    if any(id in rows for id in stale):
        write_rows(path, [row for id, row in rows.items() if id not in stale])
    tell = (lambda progress: None) if args.quiet else _print_progress
    runner = SceneRunner(out, plugins, args.overwrite)
    rows = run_resumable(jobs, runner, path, workers=workers, key_name="id", on_done=tell)
    failed = [id for id, row in rows.items() if "failure" in row]
    for id in failed:
        remove_abandoned(out / id, id)  # of workers that died
    write_summary(out, rows)
    if not args.quiet:
        print(table(rows, most=40))
        print(f"{counted(rows)}; {out / 'summary.md'}")
    if failed:
        raise RunError(
            f"{len(failed)} of {len(rows)} jobs failed; {out / 'summary.md'} says why. Run again to try them."
        )
    return 0


def _print_progress(progress: "Progress") -> None:
    """Say what came of a job and how long the others take: on a terminal one line that changes, else a line a job."""
    row, seconds = progress.row, progress.seconds_left
    what = f"failed: {row['failure'][:80]}" if "failure" in row else f"{row['verdict']}, {row['psnr']:.1f} dB"
    left = (
        f"{seconds:.0f} s"
        if seconds < 120
        else f"{seconds / 60:.0f} min"
        if seconds < 7200
        else f"{seconds / 3600:.0f} h"
    )
    line = f"  [{progress.done}/{progress.total}] {progress.key}: {what}; about {left} left"
    changes = sys.stderr.isatty()
    end = "\n" if not changes or progress.done == progress.total or "failure" in row else ""
    print(f"\r\x1b[K{line}" if changes else line, end=end, file=sys.stderr, flush=True)
