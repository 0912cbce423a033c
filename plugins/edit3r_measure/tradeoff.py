"""`edit3r tradeoff`: what speed costs in accuracy, measured on this machine, and the presets that
follow from it. A plan file names points, each a choice of run settings.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from edit3r.contract.command import Command
from edit3r.contract.errors import SettingsError, did_you_mean
from edit3r.contract.settings import Settings, make_settings, merge, of_file
from edit3r.kit.command.flags import add_common, add_trust_flag
from edit3r.kit.command.results import alone_in, shown_stages, write_text
from edit3r.kit.files.configs import read_yaml
from edit3r.running import add_flags, given_flags

SHIPPED = Path(__file__).with_name("tradeoff_plan.yaml")


class TradeoffPlan(Settings):
    """A plan file."""

    base: dict[str, Any]
    """run settings of every point"""
    points: dict[str, dict[str, Any]]
    """label of each point to the run settings that it lays over the base"""
    data: tuple[str, ...]
    """folders and data sets that are measured unless others are named"""
    size: int = Field(512, ge=32, le=4096)
    """side of the largest photos [pixels]"""
    datasets: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """settings of data sets by name"""

    def settings_of(self, labels: Sequence[str] | None = None) -> dict[str, dict]:
        """Return the run settings of each point by label; `labels`: of these points only."""
        settings = {}
        for label in labels or self.points:
            if label not in self.points:
                raise SettingsError(
                    f"--only {label}: no such point.{did_you_mean(label, self.points)} "
                    f"Points: {', '.join(self.points)}."
                )
            settings[label] = merge(self.base, self.points[label])
        return settings


def read_plan(file: str = "", trusted: bool = False) -> TradeoffPlan:
    """Read a plan file, "" for the one that ships.

    Raises SettingsError naming the key that is wrong. A file that is not `trusted` gives no
    setting that names a program or an address.
    """
    path = file or SHIPPED
    content = read_yaml(path)
    return make_settings(
        TradeoffPlan, content if trusted else of_file(content), where=str(path)
    )


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
        from edit3r_measure.tradeoff_measure import (
            measure_points,
            report,
            summarize,
            write_presets,
        )

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
