"""`edit3r evaluate`: a reconstructor on scenes whose truth is known: posed photos, data sets."""

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

from edit3r.config import parse_assignments
from edit3r.contract.command import Command
from edit3r.errors import InputError, MatchingError, SettingsError
from edit3r.io.atomic import check_new_file
from edit3r.reporting import Report, collecting, track
from edit3r_measure.report import (
    check_least,
    grouped,
    markdown_table,
    write_json,
    write_text,
)

if TYPE_CHECKING:  # the command line is parsed without torch
    from edit3r.plugins.registry import Registry
    from edit3r_measure.novel_view import SceneScore

# Settings of data sets; the seeds of training are others
UNSEEN = {"procedural": {"seed": 1000, "targets": 1, "angles": [5, 25]}}


class EvaluateCommand(Command):
    """`edit3r evaluate`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        places = "photos with a cameras.json or transforms.json, or a data set such as procedural"
        add("folders", nargs="+", metavar="FOLDER|NAME", help=places)
        add(
            "--recon",
            default="edit3r",
            metavar="NAME",
            help="reconstructor (default edit3r)",
        )
        add(
            "--rasterizer",
            default="auto",
            metavar="NAME",
            help="rasterizer (default auto)",
        )
        pairs = "most pairs of photos a folder (and class of overlap), 5 to 30 degrees apart; scenes of a data set"
        add("--pairs", type=int, default=6, metavar="N", help=pairs)
        size = "side of the square the photos are cut and resized to"
        add("--size", type=int, default=256, metavar="PIXELS", help=size)
        edits = "on data sets that know a true edit: how it is carried and fused, instead of novel views"
        add("--edits", action="store_true", help=edits)
        add(
            "--index",
            metavar="FILE",
            help="pairs of an evaluation index file, by NoPoSplat's protocol",
        )
        align = "steps that align a target with its photo (default 100, 0: none), input cameras twice as many"
        add("--align", type=int, default=100, metavar="N", help=align)
        add(
            "--lpips",
            action="store_true",
            help="with --index: LPIPS, not the perceptual distance that is offline",
        )
        settings = "such as reconstructor.head.opacity=0.8 or dataset.seed=5"
        add("--set", action="append", default=[], metavar="KEY=VALUE", help=settings)
        add(
            "--plugin",
            action="append",
            default=[],
            metavar="FILE",
            help="also load this local plugin file",
        )
        add(
            "--out",
            metavar="FILE",
            help="write the table (.md) or every pair's figures (.json)",
        )
        add("--overwrite", action="store_true", help="replace a file that is there")
        add("--quiet", action="store_true", help="print the table only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.cli.console import StageConsole
        from edit3r.plugins.registry import default_registry

        settings = _checked_settings(args)
        registry = default_registry(tuple(args.plugin))
        measure = _scores if args.index is None else _scores_by_index
        with (
            StageConsole(quiet=args.quiet) as console,
            collecting(Report(on_event=console)) as report,
        ):
            scores = measure(args, settings, registry, report)
        text = as_markdown(scores)
        print(text, end="")
        if args.out and args.out.endswith(".json"):
            write_json(args.out, as_records(scores), indent=2)
        elif args.out:
            write_text(args.out, text)
        return 0


def _built(
    settings: Mapping[str, Any], args: argparse.Namespace, registry: "Registry"
) -> "list[Any]":
    """Return reconstructor and rasterizer."""
    names = {"reconstructor": args.recon, "rasterizer": args.rasterizer}
    return [
        registry.build(kind, name, **settings.get(kind, {}))
        for kind, name in names.items()
    ]


def _scores(
    args: argparse.Namespace,
    settings: Mapping[str, Any],
    registry: "Registry",
    report: Report,
) -> "list[SceneScore]":
    from edit3r_measure.novel_view import score_scene
    from edit3r_measure.scene_sources import NO_TRIPLES, SceneOptions, find_scenes

    own = {"image_size": args.size, **({"edit": "recolor"} if args.edits else {})}
    unseen = {name: {**drawn, **own} for name, drawn in UNSEEN.items()}
    datasets = {
        place: {**unseen.get(place, {}), **settings.get("dataset", {})}
        for place in args.folders
    }
    options, tools = (
        SceneOptions(args.pairs, args.size, datasets),
        _built(settings, args, registry),
    )
    sources = {place: find_scenes(place, options, registry) for place in args.folders}
    scores = []
    for place, scenes in sources.items():
        with report.stage(place):
            scores += [
                score_scene(scene.load(), *tools, args.edits)
                for scene in track(scenes, place)
            ]
    scores = [score for score in scores if score is not None]
    if not scores:
        lacking = "no true edit is known" if args.edits else NO_TRIPLES
        raise InputError(f"{args.folders[0]}: {lacking}; nothing to measure.")
    return scores


def _scores_by_index(
    args: argparse.Namespace,
    settings: Mapping[str, Any],
    registry: "Registry",
    report: Report,
) -> "list[SceneScore]":
    from edit3r_measure.novel_view import SceneScore
    from edit3r_measure.protocol import measure_pair, photos_of, read_index
    from edit3r_measure.scene_sources import rotation_degrees

    tools, distance = (
        _built(settings, args, registry),
        "lpips" if args.lpips else "perceptual",
    )
    tools.append((distance, registry.build("loss", distance)))
    own = {"image_size": args.size, **settings.get("dataset", {})}
    places = [
        place if Path(place).is_dir() else registry.build("dataset", place, **own)
        for place in args.folders
    ]
    found = grouped(
        read_index(Path(args.index)), lambda pair: f"{pair[0]} {pair[1].overlap_class}"
    )
    scores = []
    for scene, entry in track(
        [pair for pairs in found.values() for pair in pairs[: args.pairs]], args.index
    ):
        frames, count = (*entry.context, *entry.targets), len(entry.context)
        photos, failure, figures = photos_of(places, scene, frames, args.size), "", {}
        with report.stage(f"{scene} {frames}"):
            try:
                figures = measure_pair(
                    *tools, photos[:count], photos[count:], args.align
                )
            except MatchingError as error:
                failure = str(error)
        names = (
            scene,
            str(frames[0]),
            str(frames[count - 1]),
            " ".join(map(str, entry.targets)),
        )
        degrees = rotation_degrees(photos[0].c2w[:3, :3], photos[count - 1].c2w[:3, :3])
        scores.append(
            SceneScore(
                "protocol", *names, degrees, failure, figures, entry.overlap_class
            )
        )
    return scores


def _checked_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return what `--set` says; raises SettingsError for arguments that make no sense."""
    check_least(args, pairs=1, size=16, align=0)
    if args.out and not args.out.endswith((".md", ".json")):
        raise SettingsError(
            f"--out {args.out}: expected a file that ends in .md or .json."
        )
    if args.out:
        check_new_file(args.out, args.overwrite)
    settings = parse_assignments(args.set)
    unknown = sorted(set(settings) - {"reconstructor", "rasterizer", "dataset"})
    if unknown:
        raise SettingsError(
            f"--set {unknown[0]}: evaluate has settings of reconstructor, rasterizer and dataset "
            "only."
        )
    return settings


def as_records(scores: Sequence["SceneScore"]) -> list[dict[str, Any]]:
    """Return JSON data, one mapping a pair, novel views first; figures that a failure left unknown
    are null.
    """
    from edit3r_measure.novel_view import FIGURES

    pair = ("scene", "first", "second")
    abouts = {"novel view": (*pair, "target", "degrees"), "edit": pair}
    abouts["protocol"] = (*abouts["novel view"], "overlap")
    records = []
    for score in (score for kind in abouts for score in scores if score.kind == kind):
        about = {
            name: getattr(score, name) for name in (*abouts[score.kind], "failure")
        }
        figures = {
            name: score.figures.get(name, math.nan) for name in FIGURES[score.kind]
        }
        records.append(
            {
                **about,
                **{
                    name: None if math.isnan(value) else value
                    for name, value in figures.items()
                },
            }
        )
    return records


def as_markdown(scores: Sequence["SceneScore"]) -> str:
    """Return a table of the novel views and a table of the carried edits."""
    kinds = grouped(scores, lambda score: score.kind)
    return "\n".join(
        table(kinds[kind]) for kind, table in TABLES.items() if kind in kinds
    )


def _with_failures(table: str, scores: Sequence["SceneScore"]) -> str:
    lines = [
        f"- {s.scene}, {s.first} and {s.second}: {s.failure}"
        for s in scores
        if s.failure
    ]
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
"""Title and cell of each column: means over the pairs that did not fail, unless the title says
otherwise.
"""


def novel_view_table(scores: Sequence["SceneScore"]) -> str:
    """Return one row a scene and one for all pairs, then a line for each failure."""
    rows = []
    for name, group in (
        *grouped(scores, lambda score: score.scene).items(),
        ("all pairs", scores),
    ):
        done = [score.figures for score in group if not score.failure]
        summary = _summary(done) if done else None
        cells = [cell.format(**summary) if summary else "-" for _, cell in COLUMNS]
        rows.append([name, str(len(group)), str(len(group) - len(done)), *cells])
    return _with_failures(
        markdown_table(
            ["scene", "pairs", "failed", *(title for title, _ in COLUMNS)], rows
        ),
        scores,
    )


def _summary(pairs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of all figures, what is gained over the best-blurred photo, and how often
    poses are right.
    """
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
        values = [
            s.figures[name]
            for s in scores
            if not s.failure and not math.isnan(s.figures[name])
        ]
        cells = (
            [f"{fmean(values):.3f}", f"{median(values):.3f}"] if values else ["-", "-"]
        )
        rows.append([name, str(len(values)), *cells])
    return _with_failures(
        markdown_table(["carried edits", "scenes", "mean", "median"], rows), scores
    )


def protocol_table(scores: Sequence["SceneScore"]) -> str:
    """Return one row a class of overlap and one for all pairs; failures count as infinite errors of
    pose.
    """
    from edit3r_measure.protocol import AUC_DEGREES, CLASSES, auc

    names = next((list(score.figures) for score in scores if score.figures), [])
    means = [name for name in names if not name.endswith("pose_error")]
    errors = [name for name in names if name.endswith("pose_error")]
    classes, rows = grouped(scores, lambda score: score.overlap), []
    for kind in (
        *(name for name in (*CLASSES, "not classed") if name in classes),
        "all pairs",
    ):
        own = classes.get(kind, scores)
        done = [score.figures for score in own if not score.failure]
        cells = [
            f"{fmean(f[n] for f in done):.{2 if 'psnr' in n else 3}f}" if done else "-"
            for n in means
        ]
        for name in errors:
            degrees = [score.figures.get(name, math.inf) for score in own]
            cells.append(
                " / ".join(f"{auc(degrees, limit):.2f}" for limit in AUC_DEGREES)
            )
        rows.append([kind, str(len(own)), str(len(own) - len(done)), *cells])
    heads = [name.replace("_", " ") for name in means]
    heads += [
        f"AUC of {name.replace('_', ' ')} at {'/'.join(map(str, AUC_DEGREES))}°"
        for name in errors
    ]
    return _with_failures(
        markdown_table(["overlap", "pairs", "failed", *heads], rows), scores
    )


TABLES = {
    "novel view": novel_view_table,
    "edit": edit_table,
    "protocol": protocol_table,
}
