"""`edit3r bench build`: a benchmark from folders of photos, or from generated scenes."""

import argparse

HELP = "make a benchmark from a folder of scenes, or from generated scenes whose edited truth is known"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("folder", nargs="?", metavar="FOLDER", help="a folder of scenes: one folder of photos each")
    add("--out", default="bench.json", metavar="FILE", help="the manifest to write (default bench.json)")
    add("--procedural", type=int, metavar="N", help="generate N scenes with five edits each instead")
    add("--size", type=int, metavar="PIXELS", help="longer side of the pictures (photos 256, generated 128)")
    add("--seed", type=int, default=2026, metavar="N", help="of generated scenes and of edits (default 2026)")
    add("--quiet", action="store_true", help="print errors only")


def main(args: argparse.Namespace) -> int:
    from edit3r.bench.build_generated import GeneratedSettings, build_generated
    from edit3r.bench.manifest import write_bench_manifest
    from edit3r.cli._console import StageConsole
    from edit3r.config import make_settings
    from edit3r.errors import SettingsError
    from edit3r.registry import default_registry
    from edit3r.reporting import Report, collecting

    if (args.folder is None) == (args.procedural is None):
        raise SettingsError("edit3r bench build: give either a FOLDER of scenes or --procedural N.")
    if args.procedural is not None and args.procedural < 1:
        raise SettingsError(f"--procedural: must be at least 1, got {args.procedural}.")
    size = {} if args.size is None else {"image_size": args.size}
    settings = make_settings(GeneratedSettings, {"seed": args.seed, **size}, where="generator")
    with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)):
        manifest = build_generated(args.procedural, settings, default_registry())
    write_bench_manifest(args.out, manifest)
    if not args.quiet:
        print(f"{args.out}: {len(manifest.scenes)} scenes, {len(manifest.items)} edits.")
    return 0
