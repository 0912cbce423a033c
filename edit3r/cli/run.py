"""`edit3r run`: photos in, an edited 3D scene out."""

import argparse
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edit3r_measure.tradeoff.front import PRESETS

from edit3r.command import Command

if TYPE_CHECKING:
    from edit3r.reuse.state import SceneState

DEFAULT_PROMPT = "paint the motorcycle blue"


class RunCommand(Command):
    """`edit3r run`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "images",
            nargs="*",
            metavar="IMAGE|FOLDER",
            help="two or more photos of one scene; default: a packaged pair",
        )
        add("--from", dest="earlier", metavar="DIR", help="edit the scene of an earlier run again (its --out folder)")
        add("--prompt", help="what to change, such as 'paint the bike red'")
        add("--editor", metavar="NAME", help="2D editor (default recolor); see edit3r list-plugins --kind editor")
        add("--recon", metavar="NAME", help="reconstructor (default edit3r)")
        add("--rasterizer", metavar="NAME", help="rasterizer (default auto)")
        add("--segmenter", metavar="NAME", help="finds what the prompt is about, if it reads words")
        add(
            "--mask",
            nargs="+",
            action="extend",
            default=[],
            metavar="FILE",
            help="one mask per photo; white may change",
        )
        add("--edit-views", choices=("all", "first"), help="edit all photos or the first only (default all)")
        add("--config", metavar="FILE", help="YAML file of run settings, or the name of a shipped one")
        add("--set", action="append", default=[], metavar="KEY=VALUE", help="one setting, such as editor.strength=0.5")
        add("--fov", type=float, metavar="DEG", help="horizontal field of view of photos that do not tell their own")
        add("--size", type=int, metavar="PIXELS", help="longer side photos are reduced to (default 512)")
        add("--device", metavar="D", help="torch device of learned parts (default cpu)")
        add("--seed", type=int, metavar="N", help="one seed for all views (default 0)")
        add("--frames", type=int, metavar="N", help="frames of the camera path (default 36)")
        add("--gaussians", metavar="auto|all|N", help="only those the scene requires, all (default), or at most N")
        add("--refine", type=int, metavar="STEPS", help="photometric steps on the input views at most (default 0)")
        add("--quality", choices=PRESETS, help="measured preset of size, matching, network and Gaussians")
        add("--budget-ms", type=float, metavar="MS", help="best settings that are expected to take no longer")
        add("--max-gaussians", type=int, metavar="N", help="best settings with so few Gaussians, and never more")
        add("--max-memory", type=float, metavar="MIB", help="best settings that are expected to need no more memory")
        add("--views", type=int, metavar="N", help="most photos used, evenly spaced (default all)")
        add("--cameras", metavar="FILE", help="cameras.json or transforms.json with the photos' intrinsics")
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--out", metavar="DIR", default="edit3r-out", help="folder for the results (default edit3r-out)")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import pipeline, results
        from edit3r.console import StageConsole
        from edit3r.io.atomic import atomic_folder
        from edit3r.io.images import LoadedPhotos, evenly, find_photos, load_photos, packaged_pair
        from edit3r.io.masks import load_masks
        from edit3r.quality import tell
        from edit3r.registry import default_registry
        from edit3r.reporting import Report, collecting
        from edit3r.reuse.memory import Memory
        from edit3r.reuse.state import FOLDER, load_state

        earlier = load_state(args.earlier) if args.earlier else None
        memory = Memory(Path(args.earlier) / FOLDER if args.earlier else None)
        goes_on = earlier is not None and not args.images  # given photos are edited from the start
        images, cameras = (args.images, args.cameras) if args.images else packaged_pair()
        paths = [Path(record.file) for record in earlier.records] if goes_on else find_photos(images)
        config = _config(args, len(paths), earlier)
        registry = default_registry(tuple(args.plugin))
        _check_names(registry, config)
        with StageConsole(quiet=args.quiet) as console:
            report = Report(on_event=console)
            with collecting(report), report.stage("read photos"):
                given = args.mask if len(args.mask) != len(paths) else evenly(args.mask, config.views)
                if goes_on:
                    photos = LoadedPhotos(earlier.edited, earlier.records)
                else:
                    photos = load_photos(evenly(paths, config.views), fov=config.fov, size=config.size, cameras=cameras)
                masks = load_masks(given, photos) if given else None
                hashes = {file: hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in given}
                tell(config.model_dump(), len(paths))
            with atomic_folder(args.out) as folder:
                rasterizer = registry.build("rasterizer", config.rasterizer.name, **config.rasterizer.settings)
                result = pipeline.run(
                    photos.views,
                    config.prompt,
                    editor=config.editor,
                    recon=config.reconstructor,
                    segmenter=config.segmenter,
                    masks=masks,
                    edit_views=config.edit_views,
                    seed=config.seed,
                    device=config.device,
                    gaussians=config.gaussians,
                    max_gaussians=config.max_gaussians,
                    refine=config.refine,
                    rasterizer=rasterizer,
                    registry=registry,
                    report=report,
                    earlier=earlier if goes_on else None,
                    memory=memory,
                )
                results.write(folder, result, photos, hashes, rasterizer, config, earlier)
        if not args.quiet:
            print(results.summary(Path(args.out), result))
        return 0


def _config(args: argparse.Namespace, photos: int, earlier: "SceneState | None" = None):
    """What the wished quality stands for with so many photos, or the earlier run; preset or file; `--set`; flags."""
    from edit3r.config import find_config, parse_assignments, read_yaml
    from edit3r.run_config import make_run_config

    layers: list[dict[str, Any]] = []
    if args.config:
        layers.append(read_yaml(find_config(args.config)))
    layers.append(parse_assignments(args.set))
    flags = {
        "prompt": args.prompt,
        "editor": args.editor,
        "reconstructor": args.recon,
        "rasterizer": args.rasterizer,
        "segmenter": args.segmenter,
        "edit_views": args.edit_views,
        "fov": args.fov,
        "size": args.size,
        "device": args.device,
        "seed": args.seed,
        "frames": args.frames,
        "gaussians": args.gaussians,
        "refine": args.refine,
        "quality": args.quality,
        "budget_ms": args.budget_ms,
        "max_gaussians": args.max_gaussians,
        "max_memory": args.max_memory,
        "views": args.views,
    }
    named = {
        key: {"name": flags.pop(key)} for key in ("editor", "reconstructor", "rasterizer", "segmenter") if flags[key]
    }
    layers += [{key: value for key, value in flags.items() if value is not None}, named]
    if earlier is not None:
        layers.insert(0, _inherited(earlier, layers))
    elif not args.images and not any("prompt" in layer for layer in layers):
        layers.insert(0, {"prompt": DEFAULT_PROMPT})
    return make_run_config(*layers, photos=photos)


def _inherited(earlier: "SceneState", layers: list[dict[str, Any]]) -> dict[str, Any]:
    """The earlier run's frames and, unless another is asked for, its reconstructor."""
    frames = {"frames": earlier.path.count}
    named = [layer["reconstructor"] for layer in layers if "reconstructor" in layer]
    named = [choice if isinstance(choice, str) else choice.get("name") for choice in named]
    another = any(name not in (None, earlier.reconstructor["name"]) for name in named)
    wished = any(key in layer for layer in layers for key in ("quality", "budget_ms", "max_gaussians", "max_memory"))
    before = {"name": earlier.reconstructor["name"], **earlier.reconstructor["settings"]}
    return frames if another or wished else {**frames, "reconstructor": before}


def _check_names(registry, config) -> None:
    """Unknown names and missing packages end the run before any photo is read."""
    choices = {kind: getattr(config, kind) for kind in ("editor", "reconstructor", "rasterizer", "segmenter")}
    for kind, choice in choices.items():
        if choice is not None:
            registry.load_class(registry.find(kind, choice.name))
