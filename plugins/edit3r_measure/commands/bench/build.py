"""`edit3r bench build`: a benchmark from folders of photos, or from generated scenes."""

import argparse
from pathlib import Path

from edit3r.command import Command


class BenchBuild(Command):
    """`edit3r bench build`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("folder", nargs="?", metavar="FOLDER", help="a folder of scenes: one folder of photos each")
        add("--out", default="bench.json", metavar="FILE", help="the manifest to write (default bench.json)")
        add("--procedural", type=int, metavar="N", help="generate N scenes with five edits each instead")
        add("--size", type=int, metavar="PIXELS", help="longer side of the pictures (photos 256, generated 128)")
        add("--seed", type=int, default=2026, metavar="N", help="of generated scenes and of edits (default 2026)")
        add("--views", type=int, default=2, metavar="N", help="input photos of scenes without poses (default 2)")
        add("--labels", default="", metavar="A,B", help="what the photos show; with --detector what it looks for")
        add("--detector", metavar="NAME", help="finds labels and boxes, such as grounding-dino")
        add("--segmenter", metavar="NAME", help="cuts masks out of the boxes, such as sam2 or classical")
        add("--llm", metavar="URL", help="OpenAI-compatible address of a language model that proposes edits")
        add("--llm-model", metavar="NAME", help="its name there; its key is read from OPENAI_API_KEY")
        add("--vetting", metavar="FILE", help="vetting file (default: beside --out, NAME.vetting.yaml)")
        add("--no-vetting", action="store_true", help="take the first five proposals of each scene unseen")
        add("--set", action="append", default=[], metavar="KEY=VALUE", help="detector.*, segmenter.* or generator.*")
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.console import StageConsole
        from edit3r.errors import SettingsError
        from edit3r.reporting import Report, collecting
        from edit3r_measure.bench.manifest import write_bench_manifest

        if (args.folder is None) == (args.procedural is None):
            raise SettingsError("edit3r bench build: give either a FOLDER of scenes or --procedural N.")
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)):
            manifest = _generated(args) if args.folder is None else _photographed(args)
        if manifest is not None:
            write_bench_manifest(args.out, manifest)
            if not args.quiet:
                print(
                    f"{args.out}: {len(manifest.scenes)} scenes, {len(manifest.items)} edits; sha256 {manifest.sha256}"
                )
        return 0


def _generated(args: argparse.Namespace):
    from edit3r.config import make_settings
    from edit3r.errors import SettingsError
    from edit3r.registry import default_registry
    from edit3r_measure.bench.build_generated import GeneratedSettings, build_generated

    if args.procedural < 1:
        raise SettingsError(f"--procedural: must be at least 1, got {args.procedural}.")
    size = {} if args.size is None else {"image_size": args.size}
    values = {"seed": args.seed, **size, **_settings(args, {"generator"}).get("generator", {})}
    settings = make_settings(GeneratedSettings, values, where="generator")
    return build_generated(args.procedural, settings, default_registry(tuple(args.plugin)))


def _photographed(args: argparse.Namespace):
    """The manifest; None after the first step, which leaves the vetting file."""
    from edit3r.config import make_settings
    from edit3r_measure.bench.build_photos import PhotoBuild, PhotoSettings, propose
    from edit3r_measure.bench.scene_folders import find_scenes
    from edit3r_measure.bench.vetting import VettedEdit, read_vetting, write_vetting

    size = {} if args.size is None else {"image_size": args.size}
    labels = tuple(label.strip().lower() for label in args.labels.split(",") if label.strip())
    values = {"seed": args.seed, "views": args.views, "labels": labels, **size}
    settings = make_settings(PhotoSettings, values, where="build")
    out = Path(args.out)
    vetting = Path(args.vetting) if args.vetting else out.with_name(f"{out.stem}.vetting.yaml")
    scenes = find_scenes(Path(args.folder), settings.views)
    tools = _tools(args)
    if args.no_vetting:
        proposed = propose(scenes, tools, settings)
        vetted = {scene: [VettedEdit(**vars(candidate)) for candidate in own] for scene, own in proposed.items()}
    elif vetting.is_file():
        vetted = read_vetting(vetting)
    else:
        write_vetting(vetting, propose(scenes, tools, settings))
        print(f"{vetting}: edit it (keep, drop, reword), then run the same command again.")
        return None
    return PhotoBuild(tools, settings, out, vetting).manifest(scenes, vetted)


def _tools(args: argparse.Namespace):
    from edit3r.errors import SettingsError
    from edit3r.registry import default_registry
    from edit3r_measure.bench.build_photos import PhotoTools
    from edit3r_measure.bench.language_model import LanguageModel

    if (args.llm is None) != (args.llm_model is None):
        raise SettingsError("--llm and --llm-model go together: an address and the model's name there.")
    registry, settings = default_registry(tuple(args.plugin)), _settings(args, {"detector", "segmenter"})
    built = {
        kind: registry.build(kind, name, **settings.get(kind, {}))
        for kind, name in (("detector", args.detector), ("segmenter", args.segmenter))
        if name
    }
    return PhotoTools(**built, model=LanguageModel(args.llm, args.llm_model) if args.llm else None)


def _settings(args: argparse.Namespace, known: set[str]) -> dict:
    from edit3r.config import parse_assignments
    from edit3r.errors import SettingsError

    values = parse_assignments(args.set)
    if set(values) - known:
        raise SettingsError(f"--set {min(set(values) - known)}: expected settings of {' or '.join(sorted(known))}.")
    return values
