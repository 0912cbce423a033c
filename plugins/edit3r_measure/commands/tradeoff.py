"""`edit3r tradeoff`: what speed costs in accuracy, measured on this machine, and the presets that follow from it."""

import argparse
from pathlib import Path

from edit3r.command import Command


class TradeoffCommand(Command):
    """`edit3r tradeoff`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "--data",
            nargs="+",
            metavar="FOLDER|NAME",
            help="folders of photos with a cameras.json or transforms.json, or data sets (default procedural)",
        )
        add(
            "--scenes",
            type=int,
            default=2,
            metavar="N",
            help="scenes of each data set, pairs of each folder (default 2)",
        )
        add("--knobs", nargs="+", metavar="NAME", help="knobs to turn (default all), or a YAML file of knobs")
        add("--grid", action="store_true", help="every combination of the knobs, not each alone")
        add(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="run setting of every point, such as refine=5",
        )
        add("--warm-up", type=int, default=1, metavar="N", help="runs of each process that do not count (default 1)")
        add("--repeats", type=int, default=3, metavar="N", help="runs of each process that count (default 3)")
        add("--threads", type=int, metavar="N", help="threads of each run (default: as the libraries choose)")
        add("--clock", choices=("cpu", "wall"), default="cpu", help="time to rank by (default cpu)")
        add("--minutes", type=float, metavar="N", help="start no measurement after that long; run again to go on")
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--out", metavar="DIR", default="edit3r-tradeoff", help="folder that a later sweep resumes from")
        add("--page", metavar="FILE.md", help="also write table and plot into a page, between its markers")
        add("--update-presets", action="store_true", help="make the presets of edit3r run from this sweep")
        add("--list-knobs", action="store_true", help="say what can be turned, and stop")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.console import StageConsole
        from edit3r.registry import default_registry
        from edit3r.reporting import Report, collecting
        from edit3r_measure.tradeoff.distance import with_distances
        from edit3r_measure.tradeoff.figures import summarize
        from edit3r_measure.tradeoff.scenes import write_scenes
        from edit3r_measure.tradeoff.sweep import Effort, SweepFolder, sweep

        _check(args)
        plan, points = _points(args)
        if args.list_knobs:
            print("\n".join(f"{name}: {knob.about}: {', '.join(knob.values)}" for name, knob in plan.knobs.items()))
            return 0
        folder = SweepFolder(Path(args.out))
        folder.root.mkdir(parents=True, exist_ok=True)
        effort = Effort(args.warm_up, args.repeats, args.threads, args.minutes and args.minutes * 60)
        registry = default_registry(tuple(args.plugin))
        with StageConsole(quiet=args.quiet) as console, collecting(Report(on_event=console)) as report:
            with report.stage("write scenes"):
                scenes = write_scenes(
                    args.data or plan.data, folder.scenes, registry, plan.datasets, args.scenes, plan.side
                )
            with report.stage(f"measure {len(points)} points on {len(scenes)} scenes"):
                measurements = sweep(plan, points, scenes, folder, effort, args.plugin)
        missing = len(points) * len(scenes) - len(measurements)
        if missing and not args.quiet:
            print(f"{missing} measurements are missing, the time ran out; the same command goes on.")
        points = with_distances(summarize(measurements), measurements, folder.picture)
        return _write(args, folder, plan, points, measurements)


def _check(args: argparse.Namespace) -> None:
    from edit3r.errors import SettingsError

    for option, least in (("scenes", 1), ("warm_up", 0), ("repeats", 1), ("threads", 1)):
        value = getattr(args, option)
        if value is not None and value < least:
            raise SettingsError(f"--{option.replace('_', '-')}: must be at least {least}, got {value}.")


def _points(args: argparse.Namespace):
    """The plan and its points; `--knobs` names some of the shipped knobs or a file of others."""
    from edit3r.config import merge, parse_assignments
    from edit3r_measure.tradeoff.knobs import SHIPPED, make_points, read_plan

    given = args.knobs or []
    files = [name for name in given if name.endswith((".yaml", ".yml"))]
    names = [name for name in given if name not in files] or None
    plan = read_plan(files[0] if files else SHIPPED)
    plan = plan.model_copy(update={"base": merge(plan.base, parse_assignments(args.set))})
    return plan, make_points(plan, names, args.grid)


def _write(args: argparse.Namespace, folder, plan, points, measurements) -> int:
    """Table, plot, page and presets."""
    from edit3r.errors import Edit3rError, MissingDependencyError, RunError
    from edit3r.quality import preset_names, write_quality
    from edit3r_measure.tradeoff.machine import describe_machine
    from edit3r_measure.tradeoff.plot import plot
    from edit3r_measure.tradeoff.report import report, write_into_page
    from edit3r_measure.tradeoff.shipping import make_quality

    if not points:
        failures = "; ".join(dict.fromkeys(m["failure"] for m in measurements if "failure" in m))
        raise RunError(f"no point could be measured on every scene. {failures or 'The time ran out before.'}")
    how = {"photos": plan.base.get("views", 2), "clock": args.clock, "command": _command(args, plan)}
    measured = {**describe_machine(args.threads), **how}
    quality = make_quality(points, measured, plan)
    presets = {point.label: point.preset for point in quality.points if point.preset}
    text = report(points, measurements, measured, args.clock, presets)
    folder.table.write_text(text, encoding="utf-8")
    try:
        plot(points, args.clock, presets, folder.plot)
    except MissingDependencyError as error:
        print(f"no plot: {error}")
    if args.page:
        _write_page(Path(args.page), text, folder.plot, write_into_page)
    if not args.quiet:
        print(text)
    if args.update_presets:
        if len(preset_names(quality)) < 3:
            raise Edit3rError("the presets stay as they are: no three points on the front are 2x apart in time.")
        print(f"wrote {write_quality(quality)}")
    return 0


def _command(args: argparse.Namespace, plan) -> str:
    """What to type to measure the same again, without this machine's folders."""
    data = " ".join(Path(source).name for source in args.data or plan.data)
    knobs = f" --knobs {' '.join(Path(name).name for name in args.knobs)}" if args.knobs else ""
    numbers = f" --scenes {args.scenes} --warm-up {args.warm_up} --repeats {args.repeats} --clock {args.clock}"
    threads = f" --threads {args.threads}" if args.threads else ""
    flags = (" --grid" if args.grid else "") + "".join(f" --set {setting}" for setting in args.set)
    return f"edit3r tradeoff --data {data}{knobs}{numbers}{threads}{flags}"


def _write_page(page: Path, text: str, plot: Path, write_into_page) -> None:
    """The plot goes to images/ beside the page."""
    import shutil

    picture = f"images/{page.stem}.png"
    if plot.is_file():
        (page.parent / "images").mkdir(exist_ok=True)
        shutil.copyfile(plot, page.parent / picture)
    write_into_page(page, text, picture if plot.is_file() else None)
