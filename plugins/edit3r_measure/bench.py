"""`edit3r bench build|run|grid|report`: the editing benchmark.

build   folder of photos | generated scenes  ->  manifest.json             (`bench_build`,
`bench_proposals`) run     manifest, editor, reconstructor      ->  results.jsonl, pictures
(`bench_item`, `bench_metrics`) grid    manifest                             ->  the same for all
pairs    (`bench_grid`) report  folders of results                   ->  tables, a page
(`bench_report`)
"""

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edit3r.config import (
    make_settings,
    merge,
    parse_assignments,
    read_config,
)
from edit3r.contract.command import Command, add_trust_flag
from edit3r.errors import SettingsError
from edit3r_measure.report import check_least

if TYPE_CHECKING:
    from edit3r.workers import Progress
    from edit3r_measure.bench_item import Method
    from edit3r_measure.bench_manifest import Manifest


class BenchCommand(Command):
    """The editing benchmark: build its manifest, run methods on it, report them."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the three steps and their options."""
        parser.set_defaults(
            step_main=lambda args: parser.print_help() or 2
        )  # when no step is named
        steps = parser.add_subparsers(metavar="build|run|grid|report")
        for name, (declare, main) in STEPS.items():
            step = steps.add_parser(
                name, help=declare.__doc__, description=declare.__doc__
            )
            declare(step)
            step.add_argument(
                "--debug",
                action="store_true",
                help="show the full traceback of an error",
            )
            step.set_defaults(step_main=main)

    def main(self, args: argparse.Namespace) -> int | None:
        """Do the step that was named."""
        return args.step_main(args)


def _declare_build(parser: argparse.ArgumentParser) -> None:
    """Make a benchmark from folders of photos, or from generated scenes."""
    add = parser.add_argument
    add(
        "folder",
        nargs="?",
        metavar="FOLDER",
        help="a folder of scenes: one folder of photos each",
    )
    add(
        "--out",
        default="bench.json",
        metavar="FILE",
        help="the manifest to write (default bench.json)",
    )
    add(
        "--procedural",
        type=int,
        metavar="N",
        help="generate N scenes with five edits each instead",
    )
    add(
        "--size",
        type=int,
        metavar="PIXELS",
        help="longer side of the pictures (photos 256, generated 128)",
    )
    add(
        "--seed",
        type=int,
        default=2026,
        metavar="N",
        help="of generated scenes and of edits (default 2026)",
    )
    add(
        "--views",
        type=int,
        default=2,
        metavar="N",
        help="input photos of scenes without poses (default 2)",
    )
    add(
        "--labels",
        default="",
        metavar="A,B",
        help="what the photos show; with --detector what it looks for",
    )
    add(
        "--detector",
        metavar="NAME",
        help="finds labels and boxes, such as grounding-dino",
    )
    add(
        "--segmenter",
        metavar="NAME",
        help="cuts masks out of the boxes, such as sam2 or classical",
    )
    add(
        "--truth",
        metavar="EDITOR",
        help="edits the held-back photos too, such as recolor: its pictures are the truth",
    )
    add(
        "--llm",
        metavar="URL",
        help="OpenAI-compatible address of a language model that proposes edits",
    )
    add(
        "--llm-photos",
        type=int,
        default=8,
        metavar="N",
        help="photos of a scene it is shown at most (default 8)",
    )
    add(
        "--scenes",
        type=int,
        metavar="N",
        help="take N scenes of the folder, drawn by --seed; the paper has 20",
    )
    add(
        "--llm-model",
        metavar="NAME",
        help="its name there; its key is read from OPENAI_API_KEY",
    )
    add(
        "--vetting",
        metavar="FILE",
        help="vetting file (default: beside --out, NAME.vetting.yaml)",
    )
    add(
        "--no-vetting",
        action="store_true",
        help="take the first five proposals of each scene unseen",
    )
    add(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="of generator, detector, segmenter or truth",
    )
    _add_common(parser)


def _build(args: argparse.Namespace) -> int:
    from edit3r.cli.console import StageConsole
    from edit3r.reporting import Report, collecting
    from edit3r_measure.bench_manifest import write_bench_manifest

    if (args.folder is None) == (args.procedural is None):
        raise SettingsError(
            "edit3r bench build: give either a FOLDER of scenes or --procedural N."
        )
    with (
        StageConsole(quiet=args.quiet) as console,
        collecting(Report(on_event=console)),
    ):
        manifest = _from_generator(args) if args.folder is None else _from_photos(args)
    if manifest is not None:
        write_bench_manifest(args.out, manifest)
        if not args.quiet:
            print(
                f"{args.out}: {len(manifest.scenes)} scenes, {len(manifest.items)} edits; sha256 "
                f"{manifest.sha256}"
            )
            for difference in manifest.notes.get("not_as_the_paper", ()):
                print(f"  not as the paper: {difference}.")
    return 0


def _from_generator(args: argparse.Namespace) -> "Manifest":
    from edit3r.plugins.registry import default_registry
    from edit3r_measure.bench_build import GeneratedSettings, build_generated

    check_least(args, procedural=1)
    own = {"seed": args.seed, **({"image_size": args.size} if args.size else {})}
    values = merge({"generator": own}, _component_settings(args, {"generator"}))[
        "generator"
    ]
    settings = make_settings(GeneratedSettings, values, where="generator")
    return build_generated(
        args.procedural, settings, default_registry(tuple(args.plugin))
    )


def _from_photos(args: argparse.Namespace) -> "Manifest | None":
    """Return the manifest; None after the first step, which leaves the vetting file."""
    from edit3r.plugins.registry import default_registry
    from edit3r_measure.bench_build import PhotoBuild
    from edit3r_measure.bench_proposals import (
        LanguageModel,
        read_vetting,
        write_vetting,
    )

    if (args.llm is None) != (args.llm_model is None):
        raise SettingsError(
            "--llm and --llm-model go together: an address and the model's name there."
        )
    registry = default_registry(tuple(args.plugin))
    settings = _component_settings(args, {"detector", "segmenter", "truth"})
    out = Path(args.out)
    vetting = (
        Path(args.vetting)
        if args.vetting
        else out.with_name(f"{out.stem}.vetting.yaml")
    )
    given = {
        "folder": Path(args.folder),
        "out": out,
        "vetting": vetting,
        "seed": args.seed,
        "views": args.views,
    }
    given |= {"count": args.scenes, "photos_shown": args.llm_photos} | (
        {"image_size": args.size} if args.size else {}
    )
    given["labels"] = tuple(
        label.strip().lower() for label in args.labels.split(",") if label.strip()
    )
    given["model"] = LanguageModel(args.llm, args.llm_model) if args.llm else None
    for field, kind in (
        ("detector", "detector"),
        ("segmenter", "segmenter"),
        ("truth", "editor"),
    ):
        if name := getattr(args, field):
            given[field] = registry.build(kind, name, **settings.get(field, {}))
    build = make_settings(PhotoBuild, given, where="build")
    if args.no_vetting:
        return build.manifest(build.propose())
    if vetting.is_file():
        return build.manifest(read_vetting(vetting))
    write_vetting(vetting, build.propose())
    print(f"{vetting}: edit it (keep, drop, reword), then run the same command again.")
    return None


def _component_settings(args: argparse.Namespace, known: set[str]) -> dict[str, Any]:
    values = parse_assignments(args.set)
    if set(values) - known:
        raise SettingsError(
            f"--set {min(set(values) - known)}: expected settings of {' or '.join(sorted(known))}."
        )
    return values


def _declare_run(parser: argparse.ArgumentParser) -> None:
    """Take one method, or all of a configuration, through a benchmark."""
    add = parser.add_argument
    folder = "folder for results; with --config one folder a method inside it"
    add("manifest", metavar="MANIFEST", help="JSON file of edit3r bench build")
    add("--out", required=True, metavar="DIR", help=folder)
    add(
        "--config",
        metavar="FILE",
        help="YAML list of methods, or the name of a shipped one such as bench/offline",
    )
    add(
        "--only",
        action="append",
        default=[],
        metavar="LABEL",
        help="only this method of the configuration",
    )
    add(
        "--editor",
        metavar="NAME",
        help="2D editor; 'oracle' is the offline stand-in that knows the truth (default)",
    )
    add("--recon", metavar="NAME", help="reconstructor (default edit3r)")
    add(
        "--rasterizer",
        metavar="NAME",
        help="draws the pictures that are measured (default auto)",
    )
    example = "such as poses=false; LABEL.poses=... with --config"
    add("--set", action="append", default=[], metavar="KEY=VALUE", help=example)
    add_trust_flag(parser)
    add("--scenes", type=int, metavar="N", help="only the first N scenes")
    add("--edits", type=int, metavar="N", help="only the first N edits of each scene")
    add(
        "--workers",
        type=int,
        default=1,
        metavar="N",
        help="processes (default 1); the results are the same",
    )
    add(
        "--ray",
        action="store_true",
        help="spread the workers with Ray instead, here or over RAY_ADDRESS",
    )
    add(
        "--threads",
        type=int,
        default=1,
        metavar="N",
        help="threads of each worker (default 1)",
    )
    add(
        "--clip",
        default="",
        metavar="MODEL",
        help="measure CLIP t2i and direction with this model or folder",
    )
    add(
        "--inception",
        default="",
        metavar="FILE",
        help="measure C-FID and C-KID with inception-2015-12-05.pt",
    )
    add(
        "--lpips",
        action="store_true",
        help="measure LPIPS against the truth (extra lpips)",
    )
    add(
        "--no-effnet",
        action="store_true",
        help="leave out what EfficientNet's features measure",
    )
    _add_common(parser)


def _run(args: argparse.Namespace) -> int:
    _run_methods(args, _methods(args), whole_folder=not args.config)
    if not args.quiet:
        print(f"next: edit3r bench report {args.out}")
    return 0


def _run_methods(
    args: argparse.Namespace,
    methods: "list[tuple[int, Method]]",
    whole_folder: bool = False,
    every_error: bool = False,
) -> None:
    """Take each method through the manifest, into a folder of its own inside `--out` or into the
    `whole_folder`.
    """
    from edit3r.workers import Workers
    from edit3r_measure.bench_item import BenchRun, run_bench
    from edit3r_measure.bench_metrics import MetricSettings

    check_least(args, workers=1, threads=1, scenes=1, edits=1)
    networks = {
        "effnet": not args.no_effnet,
        "inception": args.inception,
        "clip": args.clip,
        "lpips": args.lpips,
    }
    metrics = MetricSettings(**networks)
    workers = Workers(args.workers, "ray" if args.ray else "processes", args.threads)
    out = Path(args.out)
    for position, method in methods:
        part = {
            "scenes": args.scenes,
            "edits": args.edits,
            "plugins": tuple(args.plugin),
        }
        how = {"every_error": every_error, "position": position}
        place = out if whole_folder else out / method.label
        run = BenchRun(Path(args.manifest), method, place, metrics, **part, **how)
        results = run_bench(
            run,
            workers,
            (lambda _: None) if args.quiet else partial(_print_progress, method.label),
        )
        if not args.quiet:
            failed = sum(bool(result.failure) for result in results.values())
            print(f"{method.label}: {len(results)} edits, {failed} failed; {run.out}")


def _methods(args: argparse.Namespace) -> "list[tuple[int, Method]]":
    """Return methods with their positions in the configuration, which are those of their
    columns.
    """
    from edit3r_measure.bench_item import Method, read_methods

    named = {
        "editor": args.editor,
        "reconstructor": args.recon,
        "rasterizer": args.rasterizer,
    }
    flags = {key: {"name": value} for key, value in named.items() if value}
    changes = parse_assignments(args.set)
    if not args.config:
        return [(0, make_settings(Method, merge(flags, changes), where="method"))]
    if flags:
        raise SettingsError(
            "--config says which methods are run; leave out --editor, --recon and --rasterizer."
        )
    config = read_config(args.config, args.trust_config)
    methods = read_methods(config, changes)
    unknown = set(args.only) - {method.label for method in methods}
    if unknown:
        listed = ", ".join(method.label for method in methods)
        raise SettingsError(
            f"--only {min(unknown)}: no such method; {args.config} has {listed}."
        )
    return [
        (n, method)
        for n, method in enumerate(methods)
        if not args.only or method.label in args.only
    ]


def _declare_grid(parser: argparse.ArgumentParser) -> None:
    """Take every installed editor with every reconstructor through a benchmark: one table, one
    page.
    """
    _declare_run(parser)
    parser.add_argument(
        "--pictures",
        type=int,
        default=5,
        metavar="N",
        help="most edits shown with pictures (default 5)",
    )
    parser.epilog = "--editor and --recon take names with commas between; --set reconstructor.refit.steps=50"


def _grid(args: argparse.Namespace) -> int:
    from edit3r.plugins.registry import default_registry
    from edit3r_measure.bench_grid import pairs_of, write_grid

    if args.config or args.only:
        raise SettingsError(
            "edit3r bench grid: --config and --only belong to edit3r bench run."
        )
    asked = {
        kind: [name.strip() for name in (names or "").split(",") if name.strip()]
        for kind, names in (("editor", args.editor), ("reconstructor", args.recon))
    }
    common = {"rasterizer": args.rasterizer} if args.rasterizer else {}
    settings = _component_settings(args, set(asked))
    pairs = pairs_of(default_registry(tuple(args.plugin)), asked, common, settings)
    tried = [
        (n, method) for n, (method, skipped) in enumerate(pairs.values()) if not skipped
    ]
    _run_methods(args, tried, every_error=True)
    table = write_grid(Path(args.out), pairs, args.pictures)
    if not args.quiet:
        print(table)
        print(Path(args.out) / "index.html")
    return 0


def _print_progress(label: str, progress: "Progress") -> None:
    """Print one line about an item, with the time left."""
    failure = progress.row["failure"]
    what = f"failed: {failure[:100]}" if failure else "done"
    print(progress.said(what, f"{label}, "), file=sys.stderr, flush=True)


def _declare_report(parser: argparse.ArgumentParser) -> None:
    """Write tables and one page from the results of several methods."""
    add = parser.add_argument
    add(
        "folders",
        nargs="+",
        metavar="DIR",
        help="folders of edit3r bench run, or folders of such",
    )
    add(
        "--out",
        metavar="DIR",
        help="folder for the report (default: report/ in the first folder)",
    )
    add(
        "--pictures",
        type=int,
        default=20,
        metavar="N",
        help="most edits shown with pictures (default 20)",
    )
    add("--quiet", action="store_true", help="print errors only")


def _report(args: argparse.Namespace) -> int:
    from edit3r.cli.console import StageConsole
    from edit3r.reporting import Report, collecting
    from edit3r_measure.bench_report import read_columns, write_report

    columns = read_columns(map(Path, args.folders))
    out = Path(args.out) if args.out else Path(args.folders[0]) / "report"
    with (
        StageConsole(quiet=args.quiet) as console,
        collecting(Report(on_event=console)),
    ):
        table = write_report(columns, out, args.pictures)
    if not args.quiet:
        print(table)
        print(f"{out / 'index.html'}")
    return 0


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE",
        help="also load this local plugin file",
    )
    parser.add_argument("--quiet", action="store_true", help="print errors only")


STEPS = {
    "build": (_declare_build, _build),
    "run": (_declare_run, _run),
    "grid": (_declare_grid, _grid),
    "report": (_declare_report, _report),
}
"""Each step of the command: what declares its options, with its help, and what does it."""
