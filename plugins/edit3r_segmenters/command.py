"""`edit3r mask`: what is selected on every photo, as mask pictures and one sheet to look at."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command
from edit3r.kit.command.flags import add_common
from edit3r.running import add_mark_flags


class MaskCommand(Command):
    """Masks of the object that clicks, a box or words mean, before anything is reconstructed."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("images", nargs="+", metavar="IMAGE|FOLDER", help="photos of one scene")
        add_mark_flags(parser)
        add("--words", dest="thing", metavar="TEXT", help="the same as --thing")
        about = "finds and follows the object (default auto)"
        add("--segmenter", default="auto", metavar="NAME", help=about)
        about = "finds the geometry that is selected by; default: as a run finds it; '' none"
        add("--matcher", metavar="NAME", help=about)
        about = "longer side photos are reduced to (default 512)"
        add("--size", type=int, default=512, metavar="PIXELS", help=about)
        about = "folder for one mask per photo, preview.png, and cache/ for a run with the masks"
        add("--out", required=True, metavar="DIR", help=about)
        add_common(
            parser,
            settings="such as segmenter.learned=false",
            overwrite="replace an earlier result in --out",
        )

    def main(self, args: argparse.Namespace) -> int:
        from dataclasses import replace

        from edit3r import default_registry
        from edit3r.contract.reporting import Report, collecting
        from edit3r.kit.cache import Cache, using
        from edit3r.kit.command.console import StageConsole
        from edit3r.kit.files.atomic import atomic_folder, check_apart
        from edit3r.kit.files.configs import parse_assignments
        from edit3r.kit.photos.images import load_photos
        from edit3r.running import (
            CACHE,
            MarkTexts,
            RunConfig,
            default_matcher,
            given_flags,
            make_run_config,
            select_with,
            usual_selector,
        )

        check_apart(args.out, *map(Path, (*args.images, *args.mask)))
        outline = make_run_config(
            {
                name: value
                for name, value in given_flags(args, RunConfig).items()
                if name in ("larger", "candidate", "grow", "invert")
            }
        )
        given = parse_assignments(args.set)
        registry = default_registry(tuple(args.plugin))
        segmenter = registry.build(
            "segmenter", args.segmenter, **given.get("segmenter", {})
        )
        matcher, answers = None, Cache()
        if args.matcher:
            matcher = registry.build(
                "matcher", args.matcher, **given.get("matcher", {})
            )
        elif args.matcher is None:
            matcher = default_matcher(registry)
        texts = MarkTexts(
            tuple(args.point),
            tuple(args.not_point),
            tuple(args.box),
            tuple(args.mask),
            args.thing,
            tuple(args.stroke),
            tuple(args.region),
        )
        with (
            StageConsole(quiet=args.quiet) as console,
            collecting(Report(on_event=console)) as report,
            using(answers),
        ):
            with report.stage("read photos"):
                photos = load_photos(args.images, size=args.size)
                marks = replace(
                    texts.read(photos),
                    larger=outline.larger,
                    candidate=outline.candidate,
                    grow=outline.grow,
                    inverted=outline.invert,
                )
            views = photos.views
            with report.stage("select"):
                chosen = select_with(views, marks, usual_selector(segmenter), matcher)
            with atomic_folder(args.out, args.overwrite) as folder:
                for name, mask in zip(views.names, chosen.masks[0]):
                    _save(mask[None].expand(3, -1, -1), folder / f"{name}_mask.png")
                answers.save(folder / CACHE)
                shown = _preview(views.images[0], chosen.masks[0, :, None])
                _save(shown, folder / "preview.png")
        if not args.quiet:
            for name, how in zip(views.names, chosen.how):
                print(f"{name}: {how}")
            print(
                f"look at {Path(args.out) / 'preview.png'}; use the masks with --mask {args.out}"
            )
        return 0


def _save(image, path: Path) -> None:
    from edit3r.kit.photos.images import save_pixels, to_bytes

    save_pixels(to_bytes(image), path, is_photo=False)


def _preview(images, masks):
    """The photos side by side, what is not selected darkened: `[3, H, V * W]`."""
    shown = (
        images * (0.25 + 0.75 * masks)
        + (1 - masks) * images.new_tensor([0.05, 0.0, 0.1])[:, None, None]
    )
    return shown.clamp(0, 1).permute(1, 2, 0, 3).flatten(2)
