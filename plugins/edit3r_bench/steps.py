"""What the steps of `edit3r bench` do; each takes the arguments of the command line."""

import argparse
import sys
from functools import partial
from pathlib import Path

from edit3r import default_registry
from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import make_settings, merge
from edit3r.kit.command.results import shown_stages
from edit3r.kit.files.configs import parse_assignments, read_config
from edit3r.kit.workers import Progress
from edit3r.running import given_flags
from edit3r_bench.generated import GeneratedSettings, build_generated
from edit3r_bench.manifest import Manifest, write_bench_manifest
from edit3r_bench.method import Method, read_methods
from edit3r_bench.options import BuildOptions, RunOptions
from edit3r_bench.photos import PhotoBuild
from edit3r_bench.proposals import read_vetting, write_vetting
from edit3r_bench.report import read_columns, write_report
from edit3r_bench.run import BenchRun, run_bench


def build(args: argparse.Namespace) -> None:
    settings = parse_assignments(args.set)
    generator = settings.pop("generator", {})
    given = merge(given_flags(args, BuildOptions), settings)
    options = make_settings(BuildOptions, given, where="bench build")
    if (args.folder is None) == (options.procedural is None):
        raise SettingsError(
            "edit3r bench build: give either a FOLDER of scenes or --procedural N."
        )
    registry = default_registry(tuple(args.plugin))
    with shown_stages(args.quiet):
        if options.procedural is None:
            manifest = _from_photos(PhotoBuild(Path(args.folder), options, registry))
        else:
            drawn = {"seed": options.seed, "image_size": options.size or 128}
            values = {**drawn, **generator}
            how = make_settings(GeneratedSettings, values, where="generator")
            manifest = build_generated(options.procedural, how, registry)
    if manifest is None:
        return
    write_bench_manifest(options.out, manifest)
    if not args.quiet:
        print(
            f"{options.out}: {len(manifest.scenes)} scenes, {len(manifest.items)} edits; sha256 "
            f"{manifest.sha256}"
        )


def _from_photos(build: PhotoBuild) -> Manifest | None:
    """Return the manifest; None after the first step, which leaves the vetting file."""
    if build.options.no_vetting:
        return build.manifest(build.propose())
    if build.vetting.is_file():
        return build.manifest(read_vetting(build.vetting))
    write_vetting(build.vetting, build.propose())
    print(
        f"{build.vetting}: edit it (keep, drop, reword), then run the same command again."
    )
    return None


def run(args: argparse.Namespace) -> None:
    options = make_settings(
        RunOptions, given_flags(args, RunOptions), where="bench run"
    )
    settings = parse_assignments(args.set)
    parts = ("editor", "reconstructor", "rasterizer")
    named = {kind: getattr(options, kind) for kind in parts if getattr(options, kind)}
    if args.config:
        if named:
            raise SettingsError(
                "--config says which methods are run; leave out --editor, --recon and --rasterizer."
            )
        methods = read_methods(read_config(args.config, args.trust_config), settings)
        labels = [method.label for method in methods]
        for label in args.only:
            if label not in labels:
                raise SettingsError(
                    f"--only {label}: no such method; {args.config} has {', '.join(labels)}."
                )
        for position, method in enumerate(methods):
            if method.label in (args.only or labels):
                _run_method(args, options, method, position)
    else:
        method = make_settings(Method, merge(named, settings), where="method")
        _run_method(args, options, method)
    if not args.quiet:
        print(f"next: edit3r bench report {args.out}")


def _run_method(
    args: argparse.Namespace,
    options: RunOptions,
    method: Method,
    position: int | None = None,
) -> None:
    """Take a method through the manifest; as one column of several, into a folder of its own."""
    out = Path(args.out)
    bench = BenchRun(
        manifest_file=Path(args.manifest),
        method=method,
        out=out if position is None else out / method.label,
        options=options,
        plugins=tuple(args.plugin),
        position=position or 0,
    )
    show = partial(_print_progress, "" if args.quiet else method.label)
    results = run_bench(bench, show)
    if not args.quiet:
        failed = sum(bool(result.failure) for result in results.values())
        print(f"{method.label}: {len(results)} edits, {failed} failed; {bench.out}")


def _print_progress(label: str, progress: Progress) -> None:
    """Print one line about an item, with the time left; nothing without a label."""
    if label:
        failure = progress.row["failure"]
        what = f"failed: {failure[:100]}" if failure else "done"
        print(progress.line(what, f"{label}, "), file=sys.stderr, flush=True)


def report(args: argparse.Namespace) -> None:
    columns = read_columns(map(Path, args.folders))
    out = Path(args.out or Path(args.folders[0]) / "report")
    table = write_report(columns, out, args.pictures)
    if not args.quiet:
        print(table)
        print(out / "index.html")
