"""`edit3r evaluate`: novel views between the photos of posed folders, against the photos that were really there."""

import argparse

from edit3r.command import Command


class EvaluateCommand(Command):
    """`edit3r evaluate`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("folders", nargs="+", metavar="FOLDER", help="photos with a cameras.json or transforms.json")
        add("--recon", required=True, metavar="NAME", help="reconstructor")
        add("--rasterizer", default="auto", metavar="NAME", help="rasterizer (default auto)")
        add("--pairs", type=int, default=6, metavar="N", help="most pairs of photos a folder, 5 to 30 degrees apart")
        add(
            "--size",
            type=int,
            default=256,
            metavar="PIXELS",
            help="side of the square the photos are cut and resized to",
        )
        add("--set", action="append", default=[], metavar="KEY=VALUE", help="such as reconstructor.opacity=0.8")
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--out", metavar="FILE", help="write the table (.md) or every pair's figures (.json)")
        add("--quiet", action="store_true", help="print the table only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.config import parse_assignments
        from edit3r.console import StageConsole
        from edit3r.errors import InputError, SettingsError
        from edit3r.io.posed_folder import read_posed_folder
        from edit3r.registry import default_registry
        from edit3r.reporting import Report, collecting
        from edit3r_measure.evaluation.novel_view import evaluate_folder
        from edit3r_measure.evaluation.summary import markdown_table

        for option, least in (("pairs", 1), ("size", 16)):
            if getattr(args, option) < least:
                raise SettingsError(f"--{option}: must be at least {least}, got {getattr(args, option)}.")
        if args.out and not args.out.endswith((".md", ".json")):
            raise SettingsError(f"--out {args.out}: expected a file that ends in .md or .json.")
        settings = parse_assignments(args.set)
        if set(settings) - {"reconstructor", "rasterizer"}:
            raise SettingsError(
                f"--set {sorted(settings)[0]}: evaluate has settings of reconstructor and rasterizer only."
            )
        registry = default_registry(tuple(args.plugin))
        reconstructor = registry.build("reconstructor", args.recon, **settings.get("reconstructor", {}))
        rasterizer = registry.build("rasterizer", args.rasterizer, **settings.get("rasterizer", {}))
        folders = [read_posed_folder(path) for path in args.folders]
        scores, lines = [], []
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)) as report:
            for folder in folders:
                with report.stage(folder.name):
                    scores += evaluate_folder(folder, reconstructor, rasterizer, args.pairs, args.size)
                    lines += _depth(folder, reconstructor, rasterizer, args.size)
        if not scores and not lines:
            raise InputError(
                f"{args.folders[0]}: no two photos are 5 to 30 degrees apart with a third between them, "
                "and no true depth is there; nothing to measure."
            )
        text = (markdown_table(scores) if scores else "") + "".join(f"\n{line}\n" for line in lines)
        print(text, end="")
        if args.out:
            _write(args.out, text, scores)
        return 0


def _depth(folder, reconstructor, rasterizer, size: int) -> list[str]:
    from edit3r.errors import MatchingError
    from edit3r_measure.evaluation.stereo import has_disparity, score_stereo

    if not has_disparity(folder):
        return []
    try:
        share = score_stereo(folder, reconstructor, rasterizer, size)
    except MatchingError as error:
        return [f"{folder.name}: no depth, {error}"]
    return [f"{folder.name}: {share:.1%} of the pixels within 10 % of the true depth after one scale."]


def _write(path: str, text: str, scores: list) -> None:
    import json

    from edit3r.io.atomic import atomic_write
    from edit3r_measure.evaluation.summary import records

    content = json.dumps(records(scores), indent=2) + "\n" if path.endswith(".json") else text
    with atomic_write(path) as partial:
        partial.write_text(content, encoding="utf-8")
