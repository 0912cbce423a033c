"""`edit3r recolor FOLDER --out DIR`: a multi-view set recoloured region by region, alike in every
view.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.kit.command.flags import add_common
from edit3r.kit.command.results import shown_stages

if TYPE_CHECKING:
    from edit3r.kit.photos.images import LoadedPhotos
    from edit3r_recolor.scene import Masks, SceneRecipe

    Finder = Callable[[LoadedPhotos], tuple[Masks, SceneRecipe]]


class RecolorCommand(Command):
    """Recolour the objects of a folder of photos, alike in every view, as training data."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        about = "photos of one scene, in the order of the sequence"
        add("images", nargs="+", metavar="FOLDER|IMAGE", help=about)
        about = "folder for pictures, masks, recolor.json and cameras.json"
        add("--out", required=True, metavar="DIR", help=about)
        about = "finds the objects (default auto)"
        add("--segmenter", default="auto", metavar="NAME", help=about)
        about = "the data's own masks instead: a folder per object"
        add("--masks", metavar="DIR", help=about)
        about = "repeat a recolor.json with the masks beside it"
        add("--replay", metavar="FILE", help=about)
        about = "also write the pictures with an editor's faults"
        add("--augment", action="store_true", help=about)
        about = "of the colours and faults (default 0)"
        add("--seed", type=int, default=0, metavar="N", help=about)
        about = "longer side photos are reduced to (default 512)"
        add("--size", type=int, default=512, metavar="PIXELS", help=about)
        add_common(
            parser,
            settings="such as filter.min_area=0.02, segmenter.size=512",
            overwrite="replace an earlier result in --out",
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.contract.reporting import warn
        from edit3r.kit.files.atomic import atomic_folder, check_apart
        from edit3r.kit.photos.images import load_photos
        from edit3r_recolor.folder import write_folder
        from edit3r_recolor.scene import carry_out

        check_apart(args.out, *map(Path, args.images))
        _check(args)
        find = _replayed(args) if args.replay else _found(args)
        with (
            shown_stages(args.quiet) as report,
            atomic_folder(args.out, args.overwrite) as folder,
        ):
            with report.stage("read photos"):
                photos = load_photos(args.images, size=args.size)
            with report.stage("regions"):
                masks, recipe = find(photos)
            left_out = [view.name for view in recipe.views if not view.processed]
            if left_out:
                warn(
                    f"{', '.join(left_out)}: left out, because too few of the previous view's "
                    "objects were found there."
                )
            with report.stage("recolour"):
                source, faulty = photos.views.images[0], None
                images = carry_out(source, masks, recipe)
                if args.augment:
                    faulty = carry_out(source, masks, recipe, with_faults=True)
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
            "--replay: repeats what the recipe says; omit --masks and --set."
        )
    out = Path(args.out)
    if out.is_dir() and any(out.iterdir()) and not args.overwrite:
        raise InputError(
            f"{out}: is not empty; give --out another folder, or --overwrite to replace an "
            "earlier result."
        )


def _replayed(args: argparse.Namespace) -> "Finder":
    """From photos to the recipe and the masks beside it; the recipe is read and checked first."""
    from edit3r.contract.errors import InputError
    from edit3r_recolor.folder import MASKS, read_masks_of
    from edit3r_recolor.scene import SceneRecipe

    file = Path(args.replay)
    recipe = SceneRecipe.load(file)
    numbers = [region.id for region in recipe.regions]
    expected = tuple(view.name for view in recipe.views)

    def find(photos: "LoadedPhotos") -> "tuple[Masks, SceneRecipe]":
        names = tuple(photos.views.names)
        if names != expected:
            was, got = ", ".join(expected), ", ".join(names)
            raise InputError(f"{file}: was made for the photos {was}; got {got}.")
        return read_masks_of(file.parent / MASKS, photos.photos, numbers), recipe

    return find


def _found(args: argparse.Namespace) -> "Finder":
    """From photos to masks and a new recipe; all that it needs is built and checked first."""
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
    segmenter, source = None, f"masks of {args.masks}"
    if not args.masks:
        segmenter = registry.build("segmenter", args.segmenter, **for_segmenter)
        source = f"segmenter {args.segmenter}"

    def find(photos: "LoadedPhotos") -> "tuple[Masks, SceneRecipe]":
        images, names = photos.views.images[0], photos.views.names
        if segmenter is None:
            given = read_masks(Path(args.masks), photos.photos)
            regions = given_regions(given, settings)
        else:
            regions = find_regions(photos.views, segmenter, settings)
        recipe = make_recipe(images, names, regions, settings, args.seed, source)
        return regions.masks, recipe

    return find
