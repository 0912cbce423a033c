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
from edit3r.errors import InputError, MatchingError, SettingsError
from edit3r.io.run_folder import atomic_write
from edit3r.reporting import Report, collecting, track

if TYPE_CHECKING:  # the command line is parsed without torch
    from edit3r_measure.novel_view import CarriedEdit, NovelViewScore

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
        from edit3r_measure.scene_sources import NO_TRIPLES, find_scenes

        settings = _checked_settings(args)
        registry = default_registry(tuple(args.plugin))
        reconstructor = registry.build("reconstructor", args.recon, **settings.get("reconstructor", {}))
        rasterizer = registry.build("rasterizer", args.rasterizer, **settings.get("rasterizer", {}))
        options = _scene_options(args, settings.get("dataset", {}))
        sources = {place: find_scenes(place, options, registry) for place in args.folders}
        measured = Measured()
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)) as report:
            for place, scenes in sources.items():
                with report.stage(place):
                    measured.add(scenes, reconstructor, rasterizer, args.edits)
        if not (measured.pairs or measured.edits or measured.lines):
            lacking = "no true edit is known" if args.edits else f"{NO_TRIPLES}, and no true depth is there"
            raise InputError(f"{args.folders[0]}: {lacking}; nothing to measure.")
        text = measured.text()
        print(text, end="")
        if args.out:
            _write(args.out, text, measured.records())
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


class Measured:
    """What has been measured so far."""

    def __init__(self) -> None:
        self.pairs: list[NovelViewScore] = []
        self.edits: list[CarriedEdit] = []
        self.lines: list[str] = []  # true depth, and what failed outside the tables

    def add(self, sources: Sequence[Any], reconstructor: Any, rasterizer: Any, edits: bool) -> None:
        """Measure scenes: depth where no target is known, else the novel view or (`edits`) the carried edit."""
        from edit3r_measure.novel_view import score_novel_view

        for source in track(sources, "scenes"):
            scene = source.load()
            if scene.target is None:
                self.lines += [] if edits else [_depth_line(scene, reconstructor, rasterizer)]
            elif not edits:
                self.pairs.append(score_novel_view(scene, reconstructor, rasterizer))
            elif scene.edited:
                self._add_edit(source.name, scene, reconstructor, rasterizer)

    def _add_edit(self, name: str, scene: Any, reconstructor: Any, rasterizer: Any) -> None:
        from edit3r_measure.novel_view import score_carried_edit

        try:
            score = score_carried_edit(scene, reconstructor, rasterizer)
        except MatchingError as error:
            self.lines.append(f"- {name}: {error}")
            return
        self.edits += [] if score is None else [score]

    def text(self) -> str:
        """Return the tables and lines as Markdown."""
        tables = [novel_view_table(self.pairs)] if self.pairs else []
        tables += [edit_table(self.edits)] if self.edits else []
        return "\n".join([*tables, *(f"{line}\n" for line in self.lines)])

    def records(self) -> list[dict[str, Any]]:
        """Return JSON data, one mapping a pair; numbers that a failure left unknown are null."""
        return [
            {
                key: None if isinstance(value, float) and math.isnan(value) else value
                for key, value in asdict(score).items()
            }
            for score in (*self.pairs, *self.edits)
        ]


def _depth_line(scene: Any, reconstructor: Any, rasterizer: Any) -> str:
    from edit3r_measure.novel_view import score_depth

    try:
        share = score_depth(scene, reconstructor, rasterizer)
    except MatchingError as error:
        return f"{scene.source}: no depth, {error}"
    return f"{scene.source}: {share:.1%} of the pixels within 10 % of the true depth after one scale."


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
    table = markdown_table(["scene", "pairs", "failed", *(title for title, _ in COLUMNS)], rows)
    failures = [f"- {s.scene}, {s.first} and {s.second}: {s.failure}" for s in scores if s.failure]
    return "\n".join([table, *([""] if failures else []), *failures]) + "\n"


def edit_table(scores: Sequence["CarriedEdit"]) -> str:
    """Return one row a measure of how edits are carried and fused, with mean and median over the scenes."""
    from edit3r_measure.report import markdown_table

    rows = []
    for name in asdict(scores[0]):
        values = [value for value in (getattr(score, name) for score in scores) if math.isfinite(value)]
        rows.append([name, str(len(values)), *(f"{f(values):.3f}" if values else "-" for f in (fmean, median))])
    return markdown_table(["carried edits", "scenes", "mean", "median"], rows) + "\n"


def _write(path: str, text: str, records: list[dict[str, Any]]) -> None:
    content = json.dumps(records, indent=2) + "\n" if path.endswith(".json") else text
    with atomic_write(path) as partial:
        partial.write_text(content, encoding="utf-8")
