"""`edit3r render`: images, a video or a viewer page from a saved scene."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command, scene_file

MADE = ("pictures", "video", "viewer")


class RenderCommand(Command):
    """`edit3r render`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "scene",
            type=scene_file,
            metavar="SCENE",
            help="folder of a run, or Gaussians as 3DGS PLY",
        )
        add(
            "--cameras",
            metavar="FILE",
            help="cameras.json or transforms.json; default: cameras.json beside the scene",
        )
        add(
            "--make",
            nargs="+",
            choices=MADE,
            default=list(MADE),
            help="what to write (default: all three)",
        )
        add(
            "--only-view",
            type=int,
            metavar="I",
            help="only the Gaussians that come from photo I; the first is 0",
        )
        add(
            "--size",
            type=int,
            metavar="PIXELS",
            help="longer side of the pictures (default: as in the camera file)",
        )
        add(
            "--frames",
            type=int,
            default=36,
            metavar="N",
            help="frames of the video's camera path (default 36)",
        )
        add(
            "--rasterizer",
            metavar="NAME",
            help="rasterizer (default: that of edit3r run)",
        )
        add(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="such as rasterizer.background=[1,1,1]",
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
            default="edit3r-render",
            help="folder for the results (default edit3r-render)",
        )
        add(
            "--overwrite",
            action="store_true",
            help="replace an earlier result in --out even where it was changed",
        )
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        import torch

        from edit3r.cli.console import StageConsole
        from edit3r.config import parse_assignments
        from edit3r.errors import SettingsError
        from edit3r.io.atomic import atomic_folder
        from edit3r.io.images import save_image
        from edit3r.io.run_folder import RunFolder
        from edit3r.io.video import save_video
        from edit3r.io.viewer import save_viewer
        from edit3r.pipeline.config import make_run_config
        from edit3r.pipeline.rendering import path_around, render_each
        from edit3r.pipeline.write import VIDEO_FPS
        from edit3r.plugins.registry import default_registry
        from edit3r.reporting import Report, collecting, warn

        settings = parse_assignments(args.set)
        if set(settings) - {"rasterizer"}:
            raise SettingsError(
                f"--set {sorted(settings)[0]}: render has settings of the rasterizer only "
                "(rasterizer.KEY)."
            )
        if not 2 <= args.frames <= 2000:
            raise SettingsError(
                f"--frames: expected 2 to 2000 frames, got {args.frames}."
            )
        choice = make_run_config(
            settings, {"rasterizer": args.rasterizer} if args.rasterizer else {}
        ).rasterizer
        rasterizer = default_registry(tuple(args.plugin)).build_choice(
            "rasterizer", choice
        )
        with (
            StageConsole(quiet=args.quiet) as console,
            collecting(Report(on_event=console)) as report,
            torch.no_grad(),
        ):
            with report.stage("read scene"):
                gaussians = _gaussians(args)
                cameras, names = _cameras(args)
            with atomic_folder(args.out, args.overwrite) as root:
                folder = RunFolder(root)
                with report.stage("render input views"):
                    views = render_each(rasterizer, gaussians, cameras, "views")
                    if not views.alphas.any():
                        warn(
                            f"{args.scene}: nothing of it can be seen from the cameras; the "
                            "pictures are blank."
                        )
                    if "pictures" in args.make:
                        for name, image in zip(names, views.images[0]):
                            save_image(
                                image.clamp(0, 1), folder.renders / f"{name}.png"
                            )
                if "video" in args.make:
                    with report.stage("render camera path"):
                        frames = render_each(
                            rasterizer,
                            gaussians,
                            path_around(cameras, views, args.frames),
                            "path",
                        )
                        save_video(
                            folder.video, frames.images[0].clamp(0, 1), VIDEO_FPS
                        )
                if "viewer" in args.make:
                    with report.stage("write viewer"):
                        save_viewer(
                            folder.viewer,
                            gaussians,
                            cameras,
                            title=Path(args.scene).stem,
                        )
        if not args.quiet:
            print(f"wrote {args.out}")
        return 0


def _gaussians(args: argparse.Namespace):
    """The file's Gaussians, those of one view alone where that is asked for."""
    from edit3r.errors import InputError
    from edit3r.io.ply import load_ply

    gaussians = load_ply(args.scene, visible=True)
    if args.only_view is None:
        return gaussians
    known = [view for view in gaussians.view_index.unique().tolist() if view >= 0]
    if args.only_view not in known:
        listed = (
            ", ".join(map(str, known))
            or "none: the file does not say where its Gaussians come from"
        )
        raise InputError(
            f"--only-view: {args.scene} has no Gaussians of photo {args.only_view}; it has "
            f"{listed}."
        )
    return gaussians.from_view(args.only_view)


def _cameras(args: argparse.Namespace):
    """The file's cameras as one scene, at one image size, and a name for each."""
    from dataclasses import replace

    from edit3r.errors import InputError
    from edit3r.io.cameras import read_scene_cameras
    from edit3r.io.images import unique_names

    file = (
        Path(args.cameras) if args.cameras else Path(args.scene).parent / "cameras.json"
    )
    cameras, posed = read_scene_cameras(file)
    if args.size is not None:
        if not 1 <= args.size <= 8192:
            raise InputError(f"--size: expected 1 to 8192 pixels, got {args.size}.")
        scale = args.size / max(cameras.image_size)
        cameras = replace(
            cameras,
            image_size=tuple(
                max(1, round(side * scale)) for side in cameras.image_size
            ),
        )
    return cameras, unique_names([Path(camera.file).stem for camera in posed])
