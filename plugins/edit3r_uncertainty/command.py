"""`edit3r uncertainty`: say and show which parts of a finished scene can be trusted."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command
from edit3r.kit.command.flags import OVERWRITE, add_output_flags
from edit3r.kit.scenes.files import scene_file


class UncertaintyCommand(Command):
    """Show which parts of a finished scene can be trusted in a new view."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "run", type=Path, metavar="RUN", help="folder of a run, or its scene's file"
        )
        add(
            "--out",
            metavar="DIR",
            required=True,
            help="folder for the run with uncertainty; RUN is never changed",
        )
        add(
            "--maps",
            action="store_true",
            help="also write each map as a grey image (white: uncertain)",
        )
        add_output_flags(parser, OVERWRITE)

    def main(self, args: argparse.Namespace) -> int:
        import torch

        from edit3r import default_registry
        from edit3r.kit.files.atomic import atomic_folder, check_apart
        from edit3r_uncertainty.run import judge, read_run, write_run

        rasterizer = default_registry().build("rasterizer", "auto")
        run = read_run(args.run)
        check_apart(args.out, scene_file(str(args.run)))
        with torch.no_grad(), atomic_folder(args.out, args.overwrite) as folder:
            judged = judge(run, rasterizer)
            write_run(folder, judged, rasterizer, maps=args.maps)
        if not args.quiet:
            print(judged.sentence)
            print(f"wrote {args.out}; look at {Path(args.out) / 'uncertainty.png'}")
        return 0
