"""`edit3r evaluate`: a reconstructor on scenes whose truth is known: posed photos, stereo pairs, data sets."""

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

from edit3r.command import Command
from edit3r.config import parse_assignments
from edit3r.errors import InputError, SettingsError
from edit3r.io.atomic import atomic_write
from edit3r.reporting import Report, collecting, track

if TYPE_CHECKING:  # the command line is parsed without torch
    from edit3r_measure.novel_view import CarriedEdit, DepthScore, NovelViewScore

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
        settings = "such as reconstructor.opacity=0.8 or dataset.seed=5"
        add("--set", action="append", default=[], metavar="KEY=VALUE", help=settings)
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--out", metavar="FILE", help="write the table (.md) or every pair's figures (.json)")
        add("--quiet", action="store_true", help="print the table only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.console import StageConsole
        from edit3r.registry import default_registry
        from edit3r_measure.novel_view import CarriedEdit, DepthScore, NovelViewScore, score_scene
        from edit3r_measure.scene_sources import NO_TRIPLES, find_scenes

        settings = _checked_settings(args)
        registry = default_registry(tuple(args.plugin))
        reconstructor = registry.build("reconstructor", args.recon, **settings.get("reconstructor", {}))
        rasterizer = registry.build("rasterizer", args.rasterizer, **settings.get("rasterizer", {}))
        options = _scene_options(args, settings.get("dataset", {}))
        sources = {place: find_scenes(place, options, registry) for place in args.folders}
        scores = []
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)) as report:
            for place, scenes in sources.items():
                with report.stage(place):
                    found = (score_scene(s.load(), reconstructor, rasterizer, args.edits) for s in track(scenes, place))
                    scores += [score for score in found if score is not None]
        if not scores:
            lacking = "no true edit is known" if args.edits else f"{NO_TRIPLES}, and no true depth is there"
            raise InputError(f"{args.folders[0]}: {lacking}; nothing to measure.")
        kinds = (NovelViewScore, CarriedEdit, DepthScore)
        pairs, edits, depths = ([score for score in scores if isinstance(score, kind)] for kind in kinds)
        text = as_markdown(pairs, edits, depths)
        print(text, end="")
        if args.out:
            content = json.dumps(as_records([*pairs, *edits]), indent=2) + "\n" if args.out.endswith(".json") else text
            with atomic_write(args.out) as partial:
                partial.write_text(content, encoding="utf-8")
        return 0


def _checked_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return what `--set` says; raises SettingsError for arguments that make no sense."""
    for option, least in (("pairs", 1), ("size", 16)):
        if getattr(args, option) < least:
            raise SettingsError(f"--{option}: must be at least {least}, got {getattr(args, option)}.")
    if args.out and not args.out.endswith((".md", ".json")):
        raise SettingsError(f"--out {args.out}: expected a file that ends in .md or .json.")
    settings = parse_assignments(args.set)
    unknown = sorted(set(settings) - {"reconstructor", "rasterizer", "dataset"})
    if unknown:
        raise SettingsError(f"--set {unknown[0]}: evaluate has settings of reconstructor, rasterizer and dataset only.")
    return settings


def _scene_options(args: argparse.Namespace, dataset: dict[str, Any]):
    from edit3r_measure.scene_sources import SceneOptions

    own = {"image_size": args.size, **({"edit": "recolor"} if args.edits else {})}
    unseen = {name: {**settings, **own} for name, settings in UNSEEN.items()}
    given = {place: {**unseen.get(place, {}), **dataset} for place in args.folders}
    return SceneOptions(args.pairs, args.size, given)


def as_records(scores: Sequence["NovelViewScore | CarriedEdit"]) -> list[dict[str, Any]]:
    """Return JSON data, one mapping a pair; numbers that a failure left unknown are null."""
    rows = map(asdict, scores)
    return [{key: None if _is_unknown(value) else value for key, value in row.items()} for row in rows]


def _is_unknown(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)


def as_markdown(
    pairs: Sequence["NovelViewScore"], edits: Sequence["CarriedEdit"], depths: Sequence["DepthScore"]
) -> str:
    """Return a table of the novel views, a table of the carried edits, and a line for each known depth."""
    tables = [table(scores) for table, scores in ((novel_view_table, pairs), (edit_table, edits)) if scores]
    return "\n".join([*tables, *(f"{depth_line(score)}\n" for score in depths)])


def depth_line(score: "DepthScore") -> str:
    """Return one sentence."""
    if score.failure:
        return f"{score.scene}: no depth, {score.failure}"
    return f"{score.scene}: {score.right:.1%} of the pixels within 10 % of the true depth after one scale."


def _with_failures(table: str, scores: Sequence["NovelViewScore | CarriedEdit"]) -> str:
    lines = [f"- {s.scene}, {s.first} and {s.second}: {s.failure}" for s in scores if s.failure]
    return "\n".join([table, *([""] if lines else []), *lines]) + "\n"


def _mean(field: str, form: str) -> Callable[[Sequence["NovelViewScore"]], str]:
    return lambda scores: format(fmean(getattr(score, field) for score in scores), form)


def _median_rotation(scores: Sequence["NovelViewScore"]) -> str:
    return f"{median(score.rotation_error for score in scores):.2f}°"


COLUMNS: tuple[tuple[str, Callable[[Sequence["NovelViewScore"]], str]], ...] = (
    ("PSNR", _mean("psnr", ".2f")),
    ("best-blurred photo", _mean("blurred_psnr", ".2f")),
    ("gain", _mean("psnr_gain", "+.2f")),
    ("gain, covered pixels", _mean("covered_gain", "+.2f")),
    ("SSIM gain", _mean("ssim_gain", "+.3f")),
    ("coverage", _mean("coverage", ".3f")),
    ("median rotation error", _median_rotation),
    ("under 2°", lambda scores: f"{sum(s.rotation_error < 2 for s in scores) / len(scores):.0%}"),
    ("CPU s a pair", _mean("seconds", ".1f")),
)
"""Title and cell of each column: means over the pairs that did not fail, unless the title says otherwise."""


def novel_view_table(scores: Sequence["NovelViewScore"]) -> str:
    """Return one row a scene and one for all pairs, then a line for each failure."""
    from edit3r_measure.report import markdown_table

    groups = {scene: [s for s in scores if s.scene == scene] for scene in dict.fromkeys(s.scene for s in scores)}
    rows = []
    for name, group in (*groups.items(), ("all pairs", scores)):
        done = [score for score in group if not score.failure]
        cells = [cell(done) if done else "-" for _, cell in COLUMNS]
        rows.append([name, str(len(group)), str(len(group) - len(done)), *cells])
    return _with_failures(markdown_table(["scene", "pairs", "failed", *(title for title, _ in COLUMNS)], rows), scores)


def edit_table(scores: Sequence["CarriedEdit"]) -> str:
    """Return one row a measure of how edits are carried and fused, then a line for each failure."""
    from edit3r_measure.report import markdown_table

    rows = []
    for name in ("uptake", "error", "leak", "disagreement", "kept", "edited_psnr", "unedited_psnr"):
        values = [value for score in scores if not _is_unknown(value := getattr(score, name))]
        cells = [f"{fmean(values):.3f}", f"{median(values):.3f}"] if values else ["-", "-"]
        rows.append([name, str(len(values)), *cells])
    return _with_failures(markdown_table(["carried edits", "scenes", "mean", "median"], rows), scores)
