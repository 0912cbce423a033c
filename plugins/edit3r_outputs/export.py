"""`edit3r export`: a saved scene by any writer; scenes of other programs as PLY."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command
from edit3r.kit.command.results import add_common, shown_stages
from edit3r.kit.scenes.files import scene_file


class ExportCommand(Command):
    """Write a saved scene for people or other programs; a file of theirs can be read as well."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        from edit3r import default_registry

        writers = [
            offer.component.name for offer in default_registry().offers("writer")
        ]
        add = parser.add_argument
        add(
            "scene",
            type=scene_file,
            metavar="SCENE",
            help="folder of a run, or a scene's file: .ply, .compressed.ply, .spz, .sog, .splat or "
            ".glb",
        )
        add(
            "--to",
            required=True,
            nargs="+",
            metavar="WRITER",
            help=f"{', '.join(writers)} (see edit3r list-plugins --kind writer)",
        )
        add(
            "--out",
            metavar="PATH",
            help="the file or folder to write, for one writer; default: beside the scene",
        )
        add_common(parser, overwrite="replace files that are there")

    def main(self, args: argparse.Namespace) -> int:

        from edit3r import default_registry
        from edit3r.contract.errors import InputError
        from edit3r.kit.files.atomic import check_new_file
        from edit3r.running import SavedScene, write_saved

        if args.out and len(args.to) > 1:
            raise InputError(
                "--out names one place; give one writer with it, or leave --out away."
            )
        registry = default_registry(tuple(args.plugin))
        saved = SavedScene(args.scene, registry)
        writers = [registry.build("writer", name) for name in dict.fromkeys(args.to)]
        made = {}
        for writer in writers:
            name = writer.offer.component.file_name(saved.stem)
            made[writer] = Path(args.out or args.scene.with_name(name))
            check_new_file(made[writer], args.overwrite, source=args.scene)
        with shown_stages(args.quiet) as report:
            with report.stage("read scene"):
                _ = saved.gaussians
            for writer, path in made.items():
                with report.stage(f"write {writer.offer.component.name}"):
                    write_saved(writer, path, saved, args.overwrite)
        if not args.quiet:
            for path in made.values():
                size = sum(file.stat().st_size for file in (path, *path.rglob("*")))
                print(f"wrote {path} ({size / 1e6:.1f} MB)")
        return 0
