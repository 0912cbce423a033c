"""`edit3r tradeoff`: what speed costs in accuracy, measured on this machine, and the presets that
follow from it.

    plan file        -> points                    tradeoff_plan
    points, scenes   -> rows of figures           tradeoff_measure
    rows             -> presets, tables     tradeoff_report
"""

import argparse
from pathlib import Path

from pydantic import Field

from edit3r.contract.command import Command
from edit3r.contract.settings import Settings, make_settings
from edit3r.kit.command.flags import add_common, add_trust_flag
from edit3r.kit.command.results import alone_in, shown_stages, write_text
from edit3r.running import add_flags, given_flags
from edit3r_measure.tradeoff_plan import read_plan


class TradeoffOptions(Settings):
    """What the command is asked for, but for points and data."""

    plan: str = ""
    """YAML file of points; default: the one that ships"""
    scenes: int = Field(2, ge=1)
    """scenes of each data set, pairs of each folder"""
    repeats: int = Field(3, ge=1)
    """runs of each point that count, after a first one"""
    threads: int | None = Field(None, ge=1)
    """threads of each run; default: as the libraries choose"""
    out: str = "edit3r-tradeoff"
    """folder that a later call resumes"""


class TradeoffCommand(Command):
    """Measure speed against accuracy over the settings of a run, and choose the presets."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        data = "folders of photos with a cameras.json or transforms.json, or data sets"
        add("--data", nargs="+", metavar="FOLDER|NAME", help=data)
        add("--only", nargs="+", metavar="LABEL", help="only these points of the plan")
        add_flags(parser, TradeoffOptions)
        add_trust_flag(parser)
        presets = "write the presets of edit3r run that follow from the figures"
        add("--update-presets", action="store_true", help=presets)
        add_common(parser)

    def main(self, args: argparse.Namespace) -> int:
        # Heavy modules load now, so that the command line is parsed without them.
        from edit3r import default_registry
        from edit3r_measure.scene_sources import SceneOptions, find_scenes
        from edit3r_measure.tradeoff_measure import measure_points
        from edit3r_measure.tradeoff_report import report, summarize, write_presets

        given = given_flags(args, TradeoffOptions)
        options = make_settings(TradeoffOptions, given, where="tradeoff")
        plan = read_plan(options.plan, args.trust_config)
        points = plan.settings_of(args.only)
        data = args.data or plan.data
        plugins = tuple(str(Path(file).resolve()) for file in args.plugin)
        registry = default_registry(plugins)
        which = SceneOptions(options.scenes, plan.size, plan.datasets)
        scenes = [own for place in data for own in find_scenes(place, which, registry)]
        title = f"measure {len(points)} points on {len(scenes)} scenes"
        out = Path(options.out)
        with alone_in(out), shown_stages(args.quiet) as shown, shown.stage(title):
            effort = options.model_dump(include={"repeats", "threads"})
            rows = measure_points(points, scenes, out, plugins=plugins, **effort)
        names = [Path(place).name for place in data]
        quality = summarize(rows, {"data": names, "scenes": options.scenes, **effort})
        text = report(quality, rows)
        write_text(out / "tradeoff.md", text)
        if not args.quiet:
            print(text)
        if args.update_presets:
            print(f"wrote {write_presets(quality)}")
        return 0
