"""`edit3r evaluate`: a reconstructor on scenes whose truth is known: posed photos, data sets."""

import argparse
import math
from collections.abc import Mapping, Sequence
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

from edit3r.command import Command
from edit3r.config import parse_assignments
from edit3r.errors import InputError, SettingsError
from edit3r.reporting import Report, collecting, track
from edit3r_measure.report import check_least, grouped, markdown_table, write_json, write_text

if TYPE_CHECKING:  # the command line is parsed without torch
    from edit3r_measure.novel_view import SceneScore

UNSEEN = {"procedural": {"seed": 1000, "targets": 1, "angles": [5, 25]}}
"""Settings of data sets; the seeds of training are others."""


class EvaluateCommand(Command):
    """`edit3r evaluate`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        places = "photos with a cameras.json or transforms.json, or a data set such as procedural"
        add("folders", nargs="+", metavar="FOLDER|NAME", help=places)
        add("--recon", required=True, metavar="NAME", help="reconstructor")
        add("--rasterizer", default="auto", metavar="NAME", help="rasterizer (default auto)")
        pairs = "most pairs of photos a folder, 5 to 30 degrees apart; scenes of a data set"
        add("--pairs", type=int, default=6, metavar="N", help=pairs)
        size = "side of the square the photos are cut and resized to"
        add("--size", type=int, default=256, metavar="PIXELS", help=size)
        edits = "on data sets that know a true edit: how it is carried and fused, instead of novel views"
        add("--edits", action="store_true", help=edits)
        settings = "such as reconstructor.head.opacity=0.8 or dataset.seed=5"
        add("--set", action="append", default=[], metavar="KEY=VALUE", help=settings)
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--out", metavar="FILE", help="write the table (.md) or every pair's figures (.json)")
        add("--quiet", action="store_true", help="print the table only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.console import StageConsole
        from edit3r.registry import default_registry
        from edit3r_measure.novel_view import score_scene
        from edit3r_measure.scene_sources import NO_TRIPLES, SceneOptions, find_scenes

        settings = _checked_settings(args)
        registry = default_registry(tuple(args.plugin))
        reconstructor = registry.build("reconstructor", args.recon, **settings.get("reconstructor", {}))
        rasterizer = registry.build("rasterizer", args.rasterizer, **settings.get("rasterizer", {}))
        own = {"image_size": args.size, **({"edit": "recolor"} if args.edits else {})}
        unseen = {name: {**drawn, **own} for name, drawn in UNSEEN.items()}
        datasets = {place: {**unseen.get(place, {}), **settings.get("dataset", {})} for place in args.folders}
        options = SceneOptions(args.pairs, args.size, datasets)
        sources = {place: find_scenes(place, options, registry) for place in args.folders}
        scores = []
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)) as report:
            for place, scenes in sources.items():
                with report.stage(place):
                    found = (score_scene(s.load(), reconstructor, rasterizer, args.edits) for s in track(scenes, place))
                    scores += [score for score in found if score is not None]
        if not scores:
            lacking = "no true edit is known" if args.edits else NO_TRIPLES
            raise InputError(f"{args.folders[0]}: {lacking}; nothing to measure.")
        text = as_markdown(scores)
        print(text, end="")
        if args.out and args.out.endswith(".json"):
            write_json(args.out, as_records(scores), indent=2)
        elif args.out:
            write_text(args.out, text)
        return 0


def _checked_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return what `--set` says; raises SettingsError for arguments that make no sense."""
    check_least(args, pairs=1, size=16)
    if args.out and not args.out.endswith((".md", ".json")):
        raise SettingsError(f"--out {args.out}: expected a file that ends in .md or .json.")
    settings = parse_assignments(args.set)
    unknown = sorted(set(settings) - {"reconstructor", "rasterizer", "dataset"})
    if unknown:
        raise SettingsError(f"--set {unknown[0]}: evaluate has settings of reconstructor, rasterizer and dataset only.")
    return settings


def as_records(scores: Sequence["SceneScore"]) -> list[dict[str, Any]]:
    """Return JSON data, one mapping a pair, novel views first; figures that a failure left unknown are null."""
    from edit3r_measure.novel_view import FIGURES

    abouts = {"novel view": ("scene", "first", "second", "target", "degrees"), "edit": ("scene", "first", "second")}
    records = []
    for score in (score for kind in abouts for score in scores if score.kind == kind):
        about = {name: getattr(score, name) for name in (*abouts[score.kind], "failure")}
        figures = {name: score.figures.get(name, math.nan) for name in FIGURES[score.kind]}
        records.append({**about, **{name: None if math.isnan(value) else value for name, value in figures.items()}})
    return records


def as_markdown(scores: Sequence["SceneScore"]) -> str:
    """Return a table of the novel views and a table of the carried edits."""
    kinds = grouped(scores, lambda score: score.kind)
    return "\n".join(table(kinds[kind]) for kind, table in TABLES.items() if kind in kinds)


def _with_failures(table: str, scores: Sequence["SceneScore"]) -> str:
    lines = [f"- {s.scene}, {s.first} and {s.second}: {s.failure}" for s in scores if s.failure]
    return "\n".join([table, *([""] if lines else []), *lines]) + "\n"


COLUMNS = (
    ("PSNR", "{psnr:.2f}"),
    ("best-blurred photo", "{blurred_psnr:.2f}"),
    ("gain", "{psnr_gain:+.2f}"),
    ("gain, covered pixels", "{covered_gain:+.2f}"),
    ("SSIM gain", "{ssim_gain:+.3f}"),
    ("coverage", "{coverage:.3f}"),
    ("median rotation error", "{median_rotation:.2f}°"),
    ("under 2°", "{under_2:.0%}"),
    ("CPU s a pair", "{seconds:.1f}"),
)
"""Title and cell of each column: means over the pairs that did not fail, unless the title says otherwise."""


def novel_view_table(scores: Sequence["SceneScore"]) -> str:
    """Return one row a scene and one for all pairs, then a line for each failure."""
    rows = []
    for name, group in (*grouped(scores, lambda score: score.scene).items(), ("all pairs", scores)):
        done = [score.figures for score in group if not score.failure]
        summary = _summary(done) if done else None
        cells = [cell.format(**summary) if summary else "-" for _, cell in COLUMNS]
        rows.append([name, str(len(group)), str(len(group) - len(done)), *cells])
    return _with_failures(markdown_table(["scene", "pairs", "failed", *(title for title, _ in COLUMNS)], rows), scores)


def _summary(pairs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of all figures, what is gained over the best-blurred photo, and how often poses are right."""
    mean = {name: fmean(pair[name] for pair in pairs) for name in pairs[0]}
    rotations = [pair["rotation_error"] for pair in pairs]
    return {
        **mean,
        "psnr_gain": mean["psnr"] - mean["blurred_psnr"],
        "covered_gain": mean["covered_psnr"] - mean["covered_blurred_psnr"],
        "ssim_gain": mean["ssim"] - mean["blurred_ssim"],
        "median_rotation": median(rotations),
        "under_2": fmean(rotation < 2 for rotation in rotations),
    }


def edit_table(scores: Sequence["SceneScore"]) -> str:
    """Return one row a measure of how edits are carried and fused, then a line for each failure."""
    from edit3r_measure.novel_view import FIGURES

    rows = []
    for name in FIGURES["edit"]:
        values = [s.figures[name] for s in scores if not s.failure and not math.isnan(s.figures[name])]
        cells = [f"{fmean(values):.3f}", f"{median(values):.3f}"] if values else ["-", "-"]
        rows.append([name, str(len(values)), *cells])
    return _with_failures(markdown_table(["carried edits", "scenes", "mean", "median"], rows), scores)


TABLES = {"novel view": novel_view_table, "edit": edit_table}
