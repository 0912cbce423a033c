"""`edit3r tradeoff`: what speed costs in accuracy, measured on this machine, and the presets that
follow from it.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edit3r.cli.console import StageConsole
from edit3r.config import merge, parse_assignments
from edit3r.contract.command import Command, add_trust_flag
from edit3r.errors import Edit3rError, MissingDependencyError, RunError
from edit3r.plugins.registry import default_registry
from edit3r.reporting import Report, collecting
from edit3r_measure.report import check_least
from edit3r_measure.tradeoff_knobs import SHIPPED, SweepPlan, make_points, read_plan


class TradeoffCommand(Command):
    """`edit3r tradeoff`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        data = "folders of photos with a cameras.json or transforms.json, or data sets (default procedural)"
        add("--data", nargs="+", metavar="FOLDER|NAME", help=data)
        scenes = "scenes of each data set, pairs of each folder (default 2)"
        add("--scenes", type=int, default=2, metavar="N", help=scenes)
        add(
            "--knobs",
            nargs="+",
            metavar="NAME",
            help="knobs to turn (default all), or a YAML file of knobs",
        )
        add(
            "--grid",
            action="store_true",
            help="every combination of the knobs, not each alone",
        )
        settings = "run setting of every point, such as refine=5"
        add("--set", action="append", default=[], metavar="KEY=VALUE", help=settings)
        add_trust_flag(parser)
        add(
            "--warm-up",
            type=int,
            default=1,
            metavar="N",
            help="runs of each process that do not count (default 1)",
        )
        add(
            "--repeats",
            type=int,
            default=3,
            metavar="N",
            help="runs of each process that count (default 3)",
        )
        add(
            "--threads",
            type=int,
            metavar="N",
            help="threads of each run (default: as the libraries choose)",
        )
        add(
            "--clock",
            choices=("cpu", "wall"),
            default="cpu",
            help="time to rank by (default cpu)",
        )
        add(
            "--minutes",
            type=float,
            metavar="N",
            help="start no measurement after that long; run again to go on",
        )
        add(
            "--plugin",
            action="append",
            default=[],
            metavar="FILE",
            help="also load this local plugin file",
        )
        add(
            "--out",
            metavar="DIR",
            default="edit3r-tradeoff",
            help="folder that a later sweep resumes from",
        )
        add(
            "--page",
            metavar="FILE.md",
            help="also write table and plot into a page, between its markers",
        )
        add(
            "--update-presets",
            action="store_true",
            help="make the presets of edit3r run from this sweep",
        )
        add(
            "--list-knobs", action="store_true", help="say what can be turned, and stop"
        )
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        check_least(args, scenes=1, warm_up=0, repeats=1, threads=1)
        plan, points = _plan_and_points(args)
        if args.list_knobs:
            print(
                "\n".join(
                    f"{name}: {knob.about}: {', '.join(knob.values)}"
                    for name, knob in plan.knobs.items()
                )
            )
            return 0
        from edit3r_measure.tradeoff_measure import Job, Sweep
        from edit3r_measure.tradeoff_points import summarize, with_distances

        plugins = [str(Path(file).resolve()) for file in args.plugin]
        runs = {"warm_up": args.warm_up, "repeats": args.repeats, "plugins": plugins}
        runs["trust_config"] = args.trust_config
        job = Job(plan.unedited, plan.edited, perceptual=plan.perceptual, **runs)
        sweep = Sweep(
            Path(args.out), job, args.threads, args.minutes and args.minutes * 60
        )
        sweep.root.mkdir(parents=True, exist_ok=True)
        measurements = _measure(args, plan, points, sweep)
        _report(
            args,
            plan,
            with_distances(summarize(measurements), measurements, sweep.image),
            measurements,
        )
        return 0


def _plan_and_points(
    args: argparse.Namespace,
) -> tuple[SweepPlan, dict[str, dict[str, Any]]]:
    """Read the plan and make its points; `--knobs` names some of the shipped knobs or a file of
    others.
    """
    files = [name for name in args.knobs or () if name.endswith((".yaml", ".yml"))]
    names = [name for name in args.knobs or () if name not in files] or None
    plan = read_plan(files[0] if files else SHIPPED)
    plan = plan.model_copy(
        update={"base": merge(plan.base, parse_assignments(args.set))}
    )
    return plan, make_points(plan, names, args.grid)


def _measure(
    args: argparse.Namespace, plan: SweepPlan, points: Mapping[str, Any], sweep: Any
) -> list[dict[str, Any]]:
    """Write the scenes and measure what is missing; returns all measurements."""
    from edit3r_measure.scene_sources import SceneOptions, write_scenes

    options = SceneOptions(args.scenes, plan.side, plan.datasets, more_inputs=True)
    registry = default_registry(tuple(args.plugin))
    with (
        StageConsole(quiet=args.quiet) as console,
        collecting(Report(on_event=console)) as report,
    ):
        with report.stage("write scenes"):
            scenes = write_scenes(
                args.data or plan.data, options, sweep.root / "scenes", registry
            )
        with report.stage(f"measure {len(points)} points on {len(scenes)} scenes"):
            measurements = sweep.measure(points, scenes)
    missing = len(points) * len(scenes) - len(measurements)
    if missing and not args.quiet:
        print(
            f"{missing} measurements are missing, the time ran out; the same command goes on."
        )
    return measurements


def _report(
    args: argparse.Namespace,
    plan: SweepPlan,
    points: Sequence[Any],
    measurements: Sequence[Mapping[str, Any]],
) -> None:
    """Write table, plot, page and presets."""
    from edit3r.pipeline.quality import write_quality
    from edit3r_measure.tradeoff_points import make_quality
    from edit3r_measure.tradeoff_report import (
        describe_machine,
        plot,
        report,
        write_into_page,
    )

    if not points:
        failures = "; ".join(
            dict.fromkeys(m["failure"] for m in measurements if "failure" in m)
        )
        raise RunError(
            f"no point could be measured on every scene. {failures or 'The time ran out before.'}"
        )
    how = {
        "photos": plan.base.get("views", 2),
        "clock": args.clock,
        "command": _command(args, plan),
    }
    measured = {**describe_machine(args.threads), **how}
    quality = make_quality(points, measured, plan)
    presets = {point.label: point.preset for point in quality.points if point.preset}
    text, plotted = (
        report(points, measurements, measured, args.clock, presets),
        Path(args.out) / "tradeoff.png",
    )
    (Path(args.out) / "tradeoff.md").write_text(text, encoding="utf-8")
    try:
        plot(points, args.clock, presets, plotted)
    except MissingDependencyError as error:
        print(f"no plot: {error}")
    if args.page:
        write_into_page(Path(args.page), text, plotted)
    if not args.quiet:
        print(text)
    if args.update_presets:
        if len(presets) < 3:
            raise Edit3rError(
                "the presets stay as they are: no three points on the front lie apart in time."
            )
        print(f"wrote {write_quality(quality)}")


def _command(args: argparse.Namespace, plan: SweepPlan) -> str:
    """Return what to type to measure the same again, without this machine's folders."""
    data = " ".join(Path(source).name for source in args.data or plan.data)
    knobs = (
        f" --knobs {' '.join(Path(name).name for name in args.knobs)}"
        if args.knobs
        else ""
    )
    numbers = f" --scenes {args.scenes} --warm-up {args.warm_up} --repeats {args.repeats} --clock {args.clock}"
    threads = f" --threads {args.threads}" if args.threads else ""
    flags = (" --grid" if args.grid else "") + "".join(
        f" --set {setting}" for setting in args.set
    )
    return f"edit3r tradeoff --data {data}{knobs}{numbers}{threads}{flags}"
