"""`edit3r recolor FOLDER --out DIR`: a multi-view set recoloured region by region, alike in every
view.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edit3r.contract.command import Command

if TYPE_CHECKING:
    from edit3r.kit.photos.images import LoadedPhotos
    from edit3r_recolor.scene import Masks, SceneRecipe

    Finder = Callable[[LoadedPhotos], tuple[Masks, SceneRecipe]]


class RecolorCommand(Command):
    """`edit3r recolor`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "images",
            nargs="+",
            metavar="FOLDER|IMAGE",
            help="photos of one scene, in the order of the sequence",
        )
        add(
            "--out",
            required=True,
            metavar="DIR",
            help="folder for pictures, masks, recolor.json and cameras.json",
        )
        text = "finds and follows the objects (default classical)"
        add("--segmenter", default="classical", metavar="NAME", help=text)
        text = "the data's own masks instead: a folder per object"
        add("--masks", metavar="DIR", help=text)
        add(
            "--replay",
            metavar="FILE",
            help="repeat a recolor.json with the masks beside it",
        )
        add(
            "--augment",
            action="store_true",
            help="also write the pictures with an editor's faults",
        )
        add(
            "--seed",
            type=int,
            default=0,
            metavar="N",
            help="of the colours and faults (default 0)",
        )
        add(
            "--size",
            type=int,
            default=512,
            metavar="PIXELS",
            help="longer side photos are reduced to (default 512)",
        )
        text = "such as filter.min_area=0.02, segmenter.size=512"
        add("--set", action="append", default=[], metavar="KEY=VALUE", help=text)
        add(
            "--plugin",
            action="append",
            default=[],
            metavar="FILE",
            help="also load this local plugin file",
        )
        add(
            "--overwrite",
            action="store_true",
            help="replace an earlier result in --out",
        )
        add("--quiet", action="store_true", help="print errors only")

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.contract.reporting import Report, collecting, warn
        from edit3r.kit.command.console import StageConsole
        from edit3r.kit.files.atomic import atomic_folder, check_apart
        from edit3r.kit.photos.images import load_photos
        from edit3r_recolor.folder import write_folder
        from edit3r_recolor.scene import carry_out

        check_apart(args.out, *map(Path, args.images))
        _check(args)
        find = _replayed(args) if args.replay else _found(args)
        with StageConsole(quiet=args.quiet) as console:
            report = Report(on_event=console)
            with collecting(report), atomic_folder(args.out, args.overwrite) as folder:
                with report.stage("read photos"):
                    photos = load_photos(args.images, size=args.size)
                with report.stage("regions"):
                    masks, recipe = find(photos)
                left_out = ", ".join(
                    view.name for view in recipe.views if not view.processed
                )
                if left_out:
                    warn(
                        f"{left_out}: left out, too few of the objects of the view before were "
                        "found there."
                    )
                with report.stage("recolour"):
                    images = carry_out(photos.views.images[0], masks, recipe)
                    faulty = (
                        carry_out(photos.views.images[0], masks, recipe, True)
                        if args.augment
                        else None
                    )
                with report.stage("write"):
                    write_folder(folder, photos, masks, recipe, images, faulty)
        if not args.quiet:
            print(
                f"{len(recipe.processed)} views, {len(recipe.regions)} regions: "
                f"{Path(args.out) / 'sheet.png'}"
            )
        return 0


def _check(args: argparse.Namespace) -> None:
    """Refuse what can be refused before any photo is read."""
    from edit3r.contract.errors import InputError, SettingsError

    if args.seed < 0:
        raise SettingsError(f"--seed: must be at least 0, got {args.seed}.")
    if args.replay and (args.masks or args.set):
        raise SettingsError(
            "--replay: repeats what the recipe says; leave --masks and --set away."
        )
    out = Path(args.out)
    if out.is_dir() and any(out.iterdir()) and not args.overwrite:
        raise InputError(
            f"{out}: is not empty; give --out another folder, or --overwrite to replace an "
            "earlier result."
        )


def _replayed(args: argparse.Namespace) -> "Finder":
    """Return a function from photos to the masks beside the recipe and the recipe; it is read and
    checked first.
    """
    from edit3r.contract.errors import InputError
    from edit3r_recolor.folder import MASKS, read_masks_of
    from edit3r_recolor.scene import SceneRecipe

    recipe = SceneRecipe.load(Path(args.replay))
    numbers, expected = (
        [region.id for region in recipe.regions],
        tuple(view.name for view in recipe.views),
    )

    def find(photos: "LoadedPhotos") -> "tuple[Masks, SceneRecipe]":
        names = tuple(photos.views.names)
        if names != expected:
            was, got = ", ".join(expected), ", ".join(names)
            raise InputError(
                f"{args.replay}: was made for the photos {was}; got {got}."
            )
        return read_masks_of(
            Path(args.replay).parent / MASKS, photos.photos, numbers
        ), recipe

    return find


def _found(args: argparse.Namespace) -> "Finder":
    """Return a function from photos to masks and a new recipe; everything it needs is built and
    checked first.
    """
    from edit3r import default_registry
    from edit3r.contract.settings import make_settings
    from edit3r.kit.files.configs import parse_assignments
    from edit3r_recolor.folder import read_masks
    from edit3r_recolor.scene import (
        RecoloringSettings,
        find_regions,
        given_regions,
        make_recipe,
    )

    values = parse_assignments(args.set)
    for_segmenter = values.pop("segmenter", {})
    settings = make_settings(RecoloringSettings, values, where="recolor")
    registry = default_registry(tuple(args.plugin))
    segmenter = (
        None
        if args.masks
        else registry.build("segmenter", args.segmenter, **for_segmenter)
    )
    source = f"masks of {args.masks}" if args.masks else f"segmenter {args.segmenter}"

    def find(photos: "LoadedPhotos") -> "tuple[Masks, SceneRecipe]":
        images = photos.views.images[0]
        if segmenter is None:
            regions = given_regions(
                read_masks(Path(args.masks), photos.photos), settings
            )
        else:
            regions = find_regions(images, segmenter, settings)
        return regions.masks, make_recipe(
            images, photos.views.names, regions, settings, args.seed, source
        )

    return find
