"""`edit3r export`: a scene, its mesh, or a run's cameras, for other programs; theirs as PLY."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command
from edit3r.kit.scenes.files import scene_file

MESH = {"mesh": "-mesh.ply"}
"""The scene as triangles, and the end of the file's name."""


class ExportCommand(Command):
    """Write a scene in a format of other programs; a file of such a format can be read as well."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        from edit3r.kit.scenes.formats import CAMERA_FORMATS, FORMATS

        forms = [*FORMATS, *CAMERA_FORMATS, *MESH]
        add = parser.add_argument
        add(
            "scene",
            type=scene_file,
            metavar="SCENE",
            help="folder of a run, or a file: .ply, .compressed.ply, .spz, .sog or .splat",
        )
        add(
            "--to",
            required=True,
            nargs="+",
            choices=forms,
            metavar="FORMAT",
            help=", ".join(forms),
        )
        add(
            "--out",
            metavar="PATH",
            help="the file, or for cameras the folder, to write, for one format; default: beside "
            "the scene",
        )
        add("--overwrite", action="store_true", help="replace files that are there")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import default_registry
        from edit3r.contract.errors import InputError
        from edit3r.contract.reporting import Report, collecting
        from edit3r.kit.command.console import StageConsole
        from edit3r.kit.files.atomic import check_new_file
        from edit3r.kit.scenes.export import export_scene, load_scene
        from edit3r.kit.scenes.formats import CAMERA_FORMATS, FORMATS
        from edit3r.kit.scenes.posed_photos import export_cameras
        from edit3r_outputs.mesh import export_mesh

        scene: Path = args.scene
        if args.out and len(args.to) > 1:
            raise InputError(
                "--out names one place; give one format with it, or leave --out away."
            )
        base = (
            scene.name.removesuffix(".ply").removesuffix(".compressed")
            if scene.suffix == ".ply"
            else scene.stem
        )
        ends = {**FORMATS, **CAMERA_FORMATS, **MESH}
        made = {
            form: Path(args.out or scene.with_name(base + ends[form]))
            for form in args.to
        }
        for path in made.values():
            check_new_file(path, args.overwrite, source=scene)
        with (
            StageConsole(quiet=args.quiet) as console,
            collecting(Report(on_event=console)) as report,
        ):
            with report.stage("read scene"):
                gaussians = load_scene(scene)
            for form, path in made.items():
                with report.stage(f"write {form}"):
                    if form in FORMATS:
                        export_scene(path, gaussians, form)
                    elif form in MESH:
                        rasterizer = default_registry().build("rasterizer", "auto")
                        export_mesh(path, scene.parent, gaussians, rasterizer)
                    else:
                        export_cameras(
                            path, scene.parent, gaussians, form, args.overwrite
                        )
        if not args.quiet:
            for path in made.values():
                size = sum(file.stat().st_size for file in (path, *path.rglob("*")))
                print(f"wrote {path} ({size / 1e6:.1f} MB)")
        return 0
