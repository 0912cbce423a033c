"""`edit3r batch`: a file of jobs (`jobs`), each a run folder (`scenes`), spread over workers
(`edit3r.kit.workers`).
"""

import argparse
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError, RunError, SettingsError
from edit3r.kit.command.flags import add_common, add_trust_flag
from edit3r.kit.command.results import (
    alone_in,
    markdown_table,
    shown_stages,
    write_json,
    write_text,
)
from edit3r.kit.files.names import expanded

if TYPE_CHECKING:
    from edit3r.kit.workers import Progress, Workers
    from edit3r_batch.jobs import BatchJob

NO_RESULT = "no result"
MOST_SHOWN = 40  # jobs in the table on the terminal


class BatchCommand(Command):
    """Run thousands of scenes: each line of a file is a job in JSON, with `photos`, `prompt` and
    any setting of a run.

    A batch that was killed is called again and goes on: what is finished stays, what failed is
    tried once more.
    """

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        about = 'lines such as {"id": "bike", "photos": ["a.jpg", "b.jpg"], "seed": 1}'
        add("jobs", metavar="JOBS.jsonl", help=about)
        about = "folder for the results, with the folder of a run for each job"
        add("--out", required=True, metavar="DIR", help=about)
        about = "processes (default 1); the results are the same"
        add("--workers", type=int, default=1, metavar="N", help=about)
        about = "spread the workers with Ray instead, here or over RAY_ADDRESS"
        add("--ray", action="store_true", help=about)
        about = "threads of each worker (default 1)"
        add("--threads", type=int, default=1, metavar="N", help=about)
        about = (
            "GPUs that each worker asks Ray for, such as 1, or 0.25 for four workers on a GPU "
            "(default 0); the workers' device is then cuda"
        )
        add("--gpus-per-worker", type=float, default=0, metavar="PART", help=about)
        about = "memory that each worker asks Ray for (default: it does not ask)"
        add("--memory-per-worker", type=float, default=0, metavar="GB", help=about)
        about = "YAML file of run settings, for jobs that do not say otherwise"
        add("--config", metavar="FILE", help=about)
        add_trust_flag(parser)
        add_common(
            parser,
            settings="one such setting, such as size=256",
            overwrite="do jobs again that were done with other settings",
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import default_registry
        from edit3r.contract.settings import merge
        from edit3r.contract.verdicts import LABELS
        from edit3r.kit.files.configs import parse_assignments, read_config
        from edit3r_batch.jobs import read_jobs

        workers = _workers(args)
        args.plugin = tuple(str(Path(file).resolve()) for file in args.plugin)
        defaults = merge(
            read_config(args.config, args.trust_config) if args.config else {},
            parse_assignments(args.set),
        )
        if workers.gpus:
            defaults = merge({"device": "cuda"}, defaults)
        registry = default_registry(args.plugin)
        with shown_stages(args.quiet):
            jobs = read_jobs(Path(args.jobs), defaults, registry, args.trust_config)
        out = expanded(args.out).resolve()
        done = _done(jobs, out, args)
        with alone_in(out):
            rows = _run(jobs, done, out, args, workers)
        counts = Counter(row["verdict"] for row in rows)
        _write_summary(out, rows, counts)
        if not args.quiet:
            worst = [NO_RESULT, *reversed(LABELS)]

            def badness(row: dict[str, Any]) -> tuple[int, bool]:
                return worst.index(row["verdict"]), row.get("edit") != "doubtful"

            print(_table(sorted(rows, key=badness)[:MOST_SHOWN], longest=80))
            print(f"{_counted(counts)}; {out / 'summary.md'}")
        if counts[NO_RESULT]:
            raise RunError(
                f"{counts[NO_RESULT]} of {len(rows)} jobs gave no result; {out / 'summary.md'} "
                "says why."
            )
        return 0


def _workers(args: argparse.Namespace) -> "Workers":
    """Who does the jobs. Raises SettingsError for what cannot be asked for."""
    from edit3r.kit.workers import Workers

    for option in ("workers", "threads"):
        if getattr(args, option) < 1:
            raise SettingsError(
                f"--{option}: must be at least 1, got {getattr(args, option)}."
            )
    for option in ("gpus_per_worker", "memory_per_worker"):
        name, value = f"--{option.replace('_', '-')}", getattr(args, option)
        if not 0 <= value < 10_000:
            raise SettingsError(f"{name}: must be 0 or more, got {value}.")
        if value and not args.ray:
            raise SettingsError(f"{name} is asked of Ray; give --ray too.")
    if args.gpus_per_worker > 1 and args.gpus_per_worker % 1:
        raise SettingsError(
            f"--gpus-per-worker: a part of one GPU, or a whole number, got {args.gpus_per_worker}."
        )
    return Workers(
        args.workers,
        "ray" if args.ray else "processes",
        args.threads,
        may_die=True,
        gpus=args.gpus_per_worker,
        memory=int(args.memory_per_worker * 1e9),
    )


def _done(
    jobs: "Mapping[str, BatchJob]", out: Path, args: argparse.Namespace
) -> set[str]:
    """Ids of finished jobs. Raises InputError where a folder holds what may not be replaced."""
    from edit3r.kit.files.atomic import check_replaceable
    from edit3r_batch.scenes import record_of

    done, changed = set(), []
    for job in jobs.values():
        folder = out / job.id
        if folder.exists() and (record := record_of(folder)) == job.record:
            done.add(job.id)
        elif folder.exists():
            check_replaceable(folder, args.overwrite)
            keys = sorted(
                key
                for key in {*record, *job.record}
                if record.get(key) != job.record.get(key)
            )
            changed.append(
                f"line {job.line}: {job.id!r} was done with another {', '.join(keys)}"
            )
    if changed and not args.overwrite:
        more = f" (and {len(changed) - 1} more)" if len(changed) > 1 else ""
        raise InputError(
            f"{args.jobs}, {changed[0]}{more}; give --out another folder, or --overwrite to "
            "replace it."
        )
    return done


def _run(
    jobs: "Mapping[str, BatchJob]",
    done: set[str],
    out: Path,
    args: argparse.Namespace,
    workers: "Workers",
) -> list[dict[str, Any]]:
    """Do the jobs that are left and return the rows of all."""
    from edit3r.kit.files.atomic import remove_abandoned
    from edit3r.kit.workers import read_rows, run_resumable, write_rows
    from edit3r_batch.scenes import SceneRunner

    path = out / "results.jsonl"
    before = read_rows(path, "id", _known_row)
    again = [
        id
        for id, row in before.items()
        if id in jobs and (id not in done or "failure" in row)
    ]
    if again:
        kept = [row for id, row in before.items() if id in done or id not in jobs]
        write_rows(path, kept)
    tell = (lambda progress: None) if args.quiet else _print_progress
    rows = run_resumable(
        jobs,
        SceneRunner(out, args.plugin, args.overwrite),
        path,
        workers=workers,
        key_name="id",
        group=lambda job: job.editor,
        on_done=tell,
    )
    if rows:
        # What workers left that died, or were killed just after a folder was in place.
        remove_abandoned(*(out / id for id in rows))
    return [
        {"id": id, "verdict": NO_RESULT, "reason": row["failure"]}
        if "failure" in row
        else row
        for id, row in rows.items()
    ]


def _known_row(row: dict[str, Any]) -> dict[str, Any]:
    """A row as it is shown; one of something else is an error here."""
    from edit3r_batch.scenes import check_row

    if "failure" not in row:
        check_row(row)
        _table([row])
    return row


def _print_progress(progress: "Progress") -> None:
    """Say what came of a job and how long the others take; on a terminal one changing line."""
    row = progress.row
    what = (
        f"{NO_RESULT}: {row['failure'][:80]}"
        if "failure" in row
        else f"{row['verdict']}, {row['psnr']:.1f} dB"
    )
    line, changes = progress.line(what), sys.stderr.isatty()
    end = "" if changes and progress.done < progress.total else "\n"
    print(f"\r\x1b[K{line}" if changes else line, end=end, file=sys.stderr, flush=True)


def _counted(counts: Counter) -> str:
    return f"{counts.total()} jobs: " + ", ".join(
        f"{count} {verdict}" for verdict, count in counts.most_common()
    )


def _table(rows: list[dict[str, Any]], longest: int | None = None) -> str:
    """A Markdown table, a line a job: three answers, and why, at most `longest` characters."""
    lines = []
    for row in rows:
        why = row["reason"]
        if row.get("edit") == "doubtful":
            why = f"edit: {row['edit_reason']}; scene: {why}"
        has_scene = "psnr" in row
        line = {
            "job": row["id"],
            "selected": row.get("selected", ""),
            "edit": row.get("edit", ""),
            "scene": row["verdict"],
            "why": why[:longest].replace("|", "\\|"),
            "input views [dB]": f"{row['psnr']:.1f}" if has_scene else "",
            "Gaussians": f"{row['gaussians']:,}" if has_scene else "",
        }
        lines.append(line)
    return markdown_table(lines, left=5)


def _write_summary(out: Path, rows: list[dict[str, Any]], counts: Counter) -> None:
    """Write `summary.json` and `summary.md`, the same whoever did the jobs."""
    verdicts = dict(sorted(counts.items()))
    content = {"jobs": len(rows), "verdicts": verdicts, "rows": rows}
    write_json(out / "summary.json", content)
    write_text(out / "summary.md", f"# {_counted(counts)}\n\n{_table(rows)}\n")
