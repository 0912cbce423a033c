"""`edit3r recolor FOLDER --out DIR`: a multi-view set recoloured region by region, alike in every view."""

import argparse
from pathlib import Path

from edit3r.command import Command


class RecolorCommand(Command):
    """`edit3r recolor`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add("images", nargs="+", metavar="FOLDER|IMAGE", help="photos of one scene, in the order of the sequence")
        add("--out", required=True, metavar="DIR", help="folder for pictures, masks, recolor.json and cameras.json")
        text = "finds and follows the objects (default classical)"
        add("--segmenter", default="classical", metavar="NAME", help=text)
        text = "the data's own masks instead: a folder per object"
        add("--masks", metavar="DIR", help=text)
        add("--seed", type=int, default=0, metavar="N", help="of the colours (default 0)")
        add("--size", type=int, default=512, metavar="PIXELS", help="longer side photos are reduced to (default 512)")
        text = "such as filter.min_area=0.02, segmenter.size=512"
        add("--set", action="append", default=[], metavar="KEY=VALUE", help=text)
        add("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin file")
        add("--overwrite", action="store_true", help="replace an earlier result in --out")
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.config import make_settings, parse_assignments
        from edit3r.console import StageConsole
        from edit3r.errors import InputError, SettingsError
        from edit3r.io.atomic import atomic_folder
        from edit3r.io.images import load_photos
        from edit3r.registry import default_registry
        from edit3r.reporting import Report, collecting, warn
        from edit3r_recolor.folder import read_masks, write_folder
        from edit3r_recolor.scene import RecoloringSettings, carry_out, find_regions, given_regions, make_recipe

        if args.seed < 0:
            raise SettingsError(f"--seed: must be at least 0, got {args.seed}.")
        if Path(args.out).is_dir() and any(Path(args.out).iterdir()) and not args.overwrite:
            raise InputError(
                f"{args.out}: is not empty; give --out another folder, or --overwrite to replace a result."
            )
        values = parse_assignments(args.set)
        for_segmenter = values.pop("segmenter", {})
        settings = make_settings(RecoloringSettings, values, where="recolor")
        registry = default_registry(tuple(args.plugin))
        segmenter = None if args.masks else registry.build("segmenter", args.segmenter, **for_segmenter)
        source = f"masks of {args.masks}" if args.masks else f"segmenter {args.segmenter}"
        with StageConsole(quiet=args.quiet) as console:
            report = Report(on_event=console)
            with collecting(report), atomic_folder(args.out, args.overwrite) as folder:
                with report.stage("read photos"):
                    photos = load_photos(args.images, size=args.size)
                    images = photos.views.images[0]
                with report.stage("regions"):
                    if segmenter is None:
                        regions = given_regions(read_masks(Path(args.masks), photos.photos), settings)
                    else:
                        regions = find_regions(images, segmenter, settings)
                    recipe = make_recipe(images, photos.views.names, regions, settings, args.seed, source)
                left_out = ", ".join(view.name for view in recipe.views if not view.processed)
                if left_out:
                    warn(f"{left_out}: left out, too few of the objects of the view before were found there.")
                with report.stage("recolour"):
                    recolored = carry_out(images, regions.masks, recipe)
                with report.stage("write"):
                    write_folder(folder, photos, regions.masks, recipe, recolored)
        if not args.quiet:
            print(f"{len(recipe.processed)} views, {len(recipe.regions)} regions: {Path(args.out) / 'sheet.png'}")
        return 0
