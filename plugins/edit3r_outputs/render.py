"""`edit3r render`: images, a video or a viewer page from a saved scene."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError, SettingsError
from edit3r.kit.command.flags import OVERWRITE, add_common
from edit3r.kit.command.results import shown_stages
from edit3r.kit.scenes.files import scene_file

if TYPE_CHECKING:
    from edit3r.contract.interfaces import Rasterizer
    from edit3r.contract.types import Cameras, Gaussians
    from edit3r.running import RunFolder

MOST_SIDE = 2048  # of views, where no size is asked for [pixels]
LOOKED_AT = 256  # longer side of views that tell where the video goes [pixels]
MADE = ("pictures", "video", "viewer")


class RenderCommand(Command):
    """Pictures, a video and a viewer page from a saved scene (3DGS PLY)."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        about = "folder of a run, or a scene's .ply, .compressed.ply, .spz, .sog, .splat or .glb"
        add("scene", type=scene_file, metavar="SCENE", help=about)
        about = (
            "cameras.json, transforms.json or a COLMAP model; default: what lies beside the scene, "
            "else looks from outside"
        )
        add("--cameras", metavar="FILE", help=about)
        about = "what to write (default: all three)"
        add("--make", nargs="+", choices=MADE, default=list(MADE), help=about)
        about = (
            "longer side of the images (default: as in the camera file, at most 2048)"
        )
        add("--size", type=int, metavar="PIXELS", help=about)
        about = "frames of the video's camera path (default 36)"
        add("--frames", type=int, default=36, metavar="N", help=about)
        about = "rasterizer (default: that of edit3r run)"
        add("--rasterizer", metavar="NAME", help=about)
        about = "folder for the results (default edit3r-render)"
        add("--out", metavar="DIR", default="edit3r-render", help=about)
        add_common(
            parser,
            settings="such as rasterizer.background=[1,1,1]",
            overwrite=OVERWRITE,
        )

    def main(self, args: argparse.Namespace) -> int:
        import torch

        from edit3r.kit.files.atomic import atomic_folder, check_apart
        from edit3r.running import RunFolder

        if not 2 <= args.frames <= 2000:
            raise SettingsError(
                f"--frames: expected 2 to 2000 frames, got {args.frames}."
            )
        check_apart(args.out, args.scene)
        rasterizer = _rasterizer(args)
        with (
            shown_stages(args.quiet),
            torch.no_grad(),
            atomic_folder(args.out, args.overwrite) as folder,
        ):
            _render(RunFolder(folder), rasterizer, args)
        if not args.quiet:
            print(f"wrote {args.out}")
        return 0


def _render(
    folder: "RunFolder", rasterizer: "Rasterizer", args: argparse.Namespace
) -> None:
    """Write what `--make` names."""

    from edit3r import build
    from edit3r.contract.interfaces import SceneToWrite
    from edit3r.contract.reporting import stage, track, warn
    from edit3r.kit import asking
    from edit3r.kit.photos.images import save_image
    from edit3r.kit.rendering import Flight, path_around, render_each
    from edit3r.kit.scenes.reading import load_scene

    with stage("read scene"):
        gaussians = load_scene(args.scene)
        cameras, names = _cameras(args, gaussians)
    with stage("look at the scene"):
        # many large views would fill the memory
        views = render_each(rasterizer, gaussians, cameras.at(_small(cameras)), "views")
        if not views.alphas.any():
            warn(
                f"{args.scene}: nothing of it can be seen from the cameras; the images are blank."
            )
    if "pictures" in args.make:
        with stage("render input views"):
            for index, name in enumerate(track(names, "views")):
                view = asking.render(rasterizer, gaussians, cameras.select([index]))
                image = view.images[0, 0].clamp(0, 1)
                save_image(image, folder.subfolder("renders") / f"{name}.png")
    if "video" in args.make:
        with stage("render camera path"):
            path = path_around(cameras, views, args.frames)
            frames = Flight(rasterizer, gaussians, path)
            scene = SceneToWrite(gaussians, frames=frames)
            build("writer", "video").write(folder.video, scene)
    if "viewer" in args.make:
        with stage("write viewer"):
            title = Path(args.scene).stem
            scene = SceneToWrite(gaussians, cameras, title=title)
            build("writer", "viewer").write(folder.viewer, scene)


def _small(cameras: "Cameras") -> tuple[int, int]:
    """Height and width of views that are looked at and not kept."""
    height, width = cameras.image_size
    scale = min(1.0, LOOKED_AT / max(height, width))
    return max(1, round(scale * height)), max(1, round(scale * width))


def _rasterizer(args: argparse.Namespace) -> "Rasterizer":
    from edit3r import default_registry
    from edit3r.contract.types import RENDERED
    from edit3r.kit.checks import require_gives
    from edit3r.kit.files.configs import parse_assignments
    from edit3r.running import make_run_config

    settings = parse_assignments(args.set)
    for other in sorted(set(settings) - {"rasterizer"}):
        raise SettingsError(
            f"--set {other}: render takes only settings of the rasterizer (rasterizer.KEY)."
        )
    flag = {"rasterizer": args.rasterizer} if args.rasterizer else {}
    choice = make_run_config(settings, flag).rasterizer
    rasterizer = default_registry(tuple(args.plugin)).build_choice("rasterizer", choice)
    require_gives(rasterizer, choice.name, *RENDERED, who="render")
    return rasterizer


def _cameras(
    args: argparse.Namespace, gaussians: "Gaussians"
) -> "tuple[Cameras, list[str]]":
    """The file's cameras as one scene, at one image size, and a name for each."""
    from edit3r.contract.reporting import say
    from edit3r.kit.files.names import unique_names
    from edit3r.kit.scenes.look import look_at

    cameras, posed = look_at(args.scene, args.cameras, gaussians)
    height, width = cameras.image_size
    size = args.size
    if size is None and max(height, width) > MOST_SIDE:
        size = MOST_SIDE
        given = f"of {width}x{height} are drawn {size} pixels long"
        say("render.size", f"views {given}; --size N: N pixels")
    if size is not None:
        if not 1 <= size <= 8192:
            raise InputError(f"--size: expected 1 to 8192 pixels, got {size}.")
        scale = size / max(height, width)
        drawn = (max(1, round(height * scale)), max(1, round(width * scale)))
        cameras = cameras.at(drawn)
    return cameras, unique_names([Path(camera.file).stem for camera in posed])
