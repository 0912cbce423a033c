"""`edit3r simplify`: a saved scene with only the Gaussians it requires."""

import argparse
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.kit.scenes.files import scene_file

if TYPE_CHECKING:
    from edit3r_refiners.settings import SimplifySettings


class SimplifyCommand(Command):
    """`edit3r simplify`."""

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
            "--gaussians",
            default="auto",
            metavar="auto|N",
            help="as many as the scene requires (default), or at most N",
        )
        add(
            "--rasterizer",
            default="auto",
            metavar="NAME",
            help="rasterizer that judges what is seen (default auto)",
        )
        add(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="such as simplify.relative_price=2",
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
            metavar="FILE",
            required=True,
            help="the simplified scene, also as 3DGS PLY",
        )
        add("--overwrite", action="store_true", help="replace a file that is there")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import default_registry
        from edit3r.contract.reporting import Report, collecting
        from edit3r.kit.checks import require_gives
        from edit3r.kit.command.console import StageConsole
        from edit3r.kit.files.atomic import check_new_file
        from edit3r.kit.scenes.look import SIDES, look_at
        from edit3r.kit.scenes.ply import save_ply
        from edit3r.kit.scenes.read import load_scene
        from edit3r_refiners.simplify import simplify

        check_new_file(args.out, args.overwrite, source=args.scene)
        most, settings = _budget_and_settings(args)
        rasterizer = default_registry(tuple(args.plugin)).build(
            "rasterizer", args.rasterizer
        )
        require_gives(rasterizer, args.rasterizer, "images", who="simplify")
        with (
            StageConsole(quiet=args.quiet) as console,
            collecting(Report(on_event=console)) as report,
        ):
            with report.stage("read scene"):
                gaussians = load_scene(args.scene, visible=False)
                cameras, _ = look_at(args.scene, args.cameras, gaussians, len(SIDES))
            with report.stage("simplify"):
                result = simplify(gaussians, cameras, rasterizer, most, settings)
            with report.stage("write scene"):
                save_ply(args.out, result.gaussians)
        if not args.quiet:
            print(
                f"{result.before:,} Gaussians -> {result.gaussians.count:,}: {result.unseen:,} "
                "unseen, "
                f"{result.doubled:,} doubled, {result.merged:,} merged away; "
                f"the views' pictures agree to {result.psnr:.1f} dB\nwrote {args.out}"
            )
        return 0


def _budget_and_settings(
    args: argparse.Namespace,
) -> tuple[int | None, "SimplifySettings"]:
    """Read the most Gaussians that may be left (None: as the scene requires) and the settings of
    `simplify`.
    """
    from edit3r.contract.errors import SettingsError
    from edit3r.contract.settings import make_settings
    from edit3r.kit.files.configs import parse_assignments
    from edit3r_refiners.settings import SimplifySettings, parse_budget

    try:
        budget = parse_budget(args.gaussians)
    except ValueError as error:
        raise SettingsError(f"--gaussians: {error}, got {args.gaussians!r}.") from None
    if budget == "all":
        raise SettingsError(
            "--gaussians all: nothing to do; ask for auto or for a number."
        )
    given = parse_assignments(args.set)
    if set(given) - {"simplify"}:
        raise SettingsError(
            f"--set {sorted(given)[0]}: simplify has settings of its own only (simplify.KEY)."
        )
    settings = make_settings(
        SimplifySettings, given.get("simplify", {}), where="simplify"
    )
    return None if budget == "auto" else budget, settings
