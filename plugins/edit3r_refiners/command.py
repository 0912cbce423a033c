"""`edit3r simplify`: a saved scene with only the Gaussians it requires, or without floaters."""

import argparse
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.kit.command.flags import add_common
from edit3r.kit.scenes.files import scene_file

if TYPE_CHECKING:
    from edit3r_refiners.clean import CleanSettings
    from edit3r_refiners.settings import Budget, SimplifySettings


class SimplifyCommand(Command):
    """A saved scene (3DGS PLY) with only the Gaussians it requires, or without floaters."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "scene",
            type=scene_file,
            metavar="SCENE",
            help="folder of a run, or a scene's file: .ply, .compressed.ply, .spz, .sog, .splat or "
            ".glb",
        )
        add(
            "--cameras",
            metavar="FILE",
            help="cameras.json, transforms.json or a COLMAP model of the views; default: what lies "
            "beside the scene, else looks from outside",
        )
        add(
            "--clean",
            action="store_true",
            help="take out floaters, which hang before everything that the cameras see; without "
            "--out only say what would go",
        )
        add(
            "--gaussians",
            metavar="auto|N",
            help="as many as the scene requires (default), or at most N; with --clean all that are "
            "left, unless given",
        )
        add(
            "--rasterizer",
            default="auto",
            metavar="NAME",
            help="rasterizer that judges what is seen (default auto)",
        )
        add("--out", metavar="FILE", help="the new scene, as 3DGS PLY")
        settings = "such as simplify.relative_price=2 or clean.in_front=0.2"
        add_common(parser, settings, overwrite="replace a file that is there")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import default_registry
        from edit3r.contract.errors import SettingsError
        from edit3r.contract.reporting import Report, collecting
        from edit3r.kit.checks import require_gives
        from edit3r.kit.command.console import StageConsole
        from edit3r.kit.files.atomic import check_new_file
        from edit3r.kit.scenes.look import SIDES, look_at
        from edit3r.kit.scenes.ply import save_ply
        from edit3r.kit.scenes.reading import load_scene
        from edit3r_refiners.clean import find_floaters
        from edit3r_refiners.simplify import agreement, simplify

        if args.out:
            check_new_file(args.out, args.overwrite, source=args.scene)
        elif not args.clean:
            raise SettingsError(
                "simplify needs --out FILE, the new scene; --clean without it only says what would "
                "go."
            )
        budget, settings, clean_settings = _asked(args)
        registry = default_registry(tuple(args.plugin))
        rasterizer = registry.build("rasterizer", args.rasterizer)
        gives = ("images", "alphas", "depths") if args.clean else ("images",)
        require_gives(rasterizer, args.rasterizer, *gives, who="simplify")
        lines = []
        with (
            StageConsole(quiet=args.quiet) as console,
            collecting(Report(on_event=console)) as report,
        ):
            with report.stage("read scene"):
                gaussians = load_scene(args.scene, visible=False)
                cameras, _ = look_at(args.scene, args.cameras, gaussians, len(SIDES))
            if args.clean:
                with report.stage("clean"):
                    floaters = find_floaters(
                        gaussians, cameras, rasterizer, clean_settings
                    )
                    gaussians = gaussians.select(~floaters.found)
                lines.append(floaters.sentence)
            if args.out and budget != "all":
                with report.stage("simplify"):
                    most = None if budget == "auto" else budget
                    result = simplify(gaussians, cameras, rasterizer, most, settings)
                fewer = result.gaussians
                alike = agreement(gaussians, fewer, cameras, rasterizer)
                gaussians = fewer
                lines.append(
                    f"{result.before:,} Gaussians -> {result.gaussians.count:,}: "
                    f"{result.unseen:,} unseen, {result.doubled:,} doubled, "
                    f"{result.merged:,} merged away; the views' pictures agree to "
                    f"{alike:.1f} dB"
                )
            if args.out:
                with report.stage("write scene"):
                    save_ply(args.out, gaussians)
                lines.append(f"wrote {args.out}")
            elif floaters.found.any():
                lines.append("Nothing was written: give --out FILE to take them out.")
        if not args.quiet or not args.out:
            print("\n".join(lines))
        return 0


def _asked(
    args: argparse.Namespace,
) -> tuple["Budget", "SimplifySettings", "CleanSettings"]:
    """Read how many Gaussians may be left, and the settings of `simplify` and `clean`."""
    from edit3r.contract.errors import SettingsError
    from edit3r.contract.settings import make_settings
    from edit3r.kit.files.configs import parse_assignments
    from edit3r_refiners.clean import CleanSettings
    from edit3r_refiners.settings import SimplifySettings, parse_budget

    asked = args.gaussians or ("all" if args.clean else "auto")
    try:
        budget = parse_budget(asked)
    except ValueError as error:
        raise SettingsError(f"--gaussians: {error}, got {args.gaussians!r}.") from None
    if budget == "all" and not args.clean:
        raise SettingsError(
            "--gaussians all: nothing to do; ask for auto or for a number."
        )
    given = parse_assignments(args.set)
    strange = sorted(set(given) - {"simplify", "clean"})
    if strange:
        raise SettingsError(
            f"--set {strange[0]}: simplify takes only its own settings (simplify.KEY, clean.KEY)."
        )
    return (
        budget,
        make_settings(SimplifySettings, given.get("simplify", {}), where="simplify"),
        make_settings(CleanSettings, given.get("clean", {}), where="clean"),
    )
