"""`edit3r bench run`: one method, or all of a configuration, through a benchmark."""

import argparse
import sys
from pathlib import Path

from edit3r.command import Command


class BenchRun(Command):
    """`edit3r bench run`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("manifest", metavar="MANIFEST", help="JSON file of edit3r bench build")
        add(
            "--out",
            required=True,
            metavar="DIR",
            help="folder for results; with --config one folder a method inside it",
        )
        add("--config", metavar="FILE", help="YAML list of methods, or the name of a shipped one such as bench/offline")
        add("--only", action="append", default=[], metavar="LABEL", help="only this method of the configuration")
        add(
            "--editor",
            metavar="NAME",
            help="2D editor; 'oracle' is the offline stand-in that knows the truth (default)",
        )
        add("--recon", metavar="NAME", help="reconstructor (default edit3r)")
        add("--rasterizer", metavar="NAME", help="draws the pictures that are measured (default auto)")
        add(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="such as poses=false; LABEL.poses=... with --config",
        )
        add("--scenes", type=int, metavar="N", help="only the first N scenes")
        add("--edits", type=int, metavar="N", help="only the first N edits of each scene")
        add("--types", metavar="A,B", help="only edits of these types: Add, Remove, Modify, Global")
        add("--workers", type=int, default=1, metavar="N", help="processes (default 1); the results are the same")
        add("--ray", action="store_true", help="spread the workers with Ray instead, here or over RAY_ADDRESS")
        add("--threads", type=int, default=1, metavar="N", help="threads of each worker (default 1)")
        add("--clip", default="", metavar="MODEL", help="measure CLIP t2i and direction with this model or folder")
        add("--inception", default="", metavar="FILE", help="measure C-FID and C-KID with inception-2015-12-05.pt")
        add("--lpips", action="store_true", help="measure LPIPS against the truth (extra lpips)")
        add("--no-effnet", action="store_true", help="leave the EfficientNet variants of C-FID and C-KID out")
        add("--no-verify", action="store_true", help="accept pictures that differ from the manifest's hashes")
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.errors import SettingsError
        from edit3r_measure.bench.manifest import EDIT_TYPES
        from edit3r_measure.bench.method import InstrumentSettings
        from edit3r_measure.bench.runner import Job, run_job

        for option in ("workers", "threads", "scenes", "edits"):
            value = getattr(args, option)
            if value is not None and value < 1:
                raise SettingsError(f"--{option}: must be at least 1, got {value}.")
        types = tuple(args.types.split(",")) if args.types else ()
        if set(types) - set(EDIT_TYPES):
            raise SettingsError(f"--types {args.types}: expected some of {', '.join(EDIT_TYPES)}.")
        out = Path(args.out)
        for position, method in _methods(args):
            job = Job(
                manifest=Path(args.manifest),
                method=method,
                out=out / method.label if args.config else out,
                instruments=InstrumentSettings(
                    effnet=not args.no_effnet, inception=args.inception, clip=args.clip, lpips=args.lpips
                ),
                scenes=args.scenes,
                edits=args.edits,
                types=types,
                plugins=tuple(args.plugin),
                threads=args.threads,
                verify=not args.no_verify,
                position=position,
            )
            results = run_job(job, args.workers, "ray" if args.ray else "processes", _Lines(method.label, args.quiet))
            if not args.quiet:
                failed = sum(bool(result.failure) for result in results.values())
                print(f"{method.label}: {len(results)} edits, {failed} failed; {job.out}")
        if not args.quiet:
            print(f"next: edit3r bench report {out}")
        return 0


def _methods(args: argparse.Namespace) -> list:
    """Methods with their places in the configuration, which are those of their columns."""
    from edit3r.config import find_config, make_settings, merge, parse_assignments, read_yaml
    from edit3r.errors import SettingsError
    from edit3r_measure.bench.method import Method, read_methods

    named = {"editor": args.editor, "reconstructor": args.recon, "rasterizer": args.rasterizer}
    flags = {key: {"name": value} for key, value in named.items() if value}
    changes = parse_assignments(args.set)
    if not args.config:
        values = dict(merge(flags, changes))
        for key, name in (("editor", "oracle"), ("reconstructor", "edit3r"), ("rasterizer", "auto")):
            if isinstance(values.get(key), dict):
                values[key] = {"name": name, **values[key]}
        return [(0, make_settings(Method, values, where="method"))]
    if flags:
        raise SettingsError("--config says which methods are run; leave out --editor, --recon and --rasterizer.")
    methods = read_methods(read_yaml(find_config(args.config)), changes)
    unknown = set(args.only) - {method.label for method in methods}
    if unknown:
        listed = ", ".join(method.label for method in methods)
        raise SettingsError(f"--only {min(unknown)}: no such method; {args.config} has {listed}.")
    return [(n, method) for n, method in enumerate(methods) if not args.only or method.label in args.only]


class _Lines:
    """One line an item, with the time left."""

    def __init__(self, label: str, quiet: bool) -> None:
        self.label, self.quiet = label, quiet

    def __call__(self, progress) -> None:
        if self.quiet:
            return
        result, seconds = progress.result, progress.seconds_left
        what = f"failed: {result.failure[:100]}" if result.failure else "done"
        left = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
        place = f"  [{progress.done}/{progress.total}] {self.label}, {result.id}"
        print(f"{place}: {what}; about {left} left", file=sys.stderr, flush=True)
