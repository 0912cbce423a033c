"""`edit3r run`: photos in, an edited 3D scene out."""

import argparse
import gc
import types
import typing
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic.fields import FieldInfo

from edit3r.cli.marks import add_mark_flags, selection_from
from edit3r.config import PartChoice
from edit3r.contract.command import Command
from edit3r.errors import InputError, RunError
from edit3r.pipeline.config import DEFAULTS, PART_KEYS, RunConfig, make_run_config

if TYPE_CHECKING:
    from torch import Tensor

    from edit3r.contract.types import Views
    from edit3r.io.images import LoadedPhotos
    from edit3r.pipeline.earlier import EarlierRun
    from edit3r.pipeline.steps import RunResult
    from edit3r.plugins.registry import Registry
    from edit3r.reporting import Report
    from edit3r.selection.select import Selection

SHORT_FLAGS = {"reconstructor": "recon"}
"""Settings whose flag is not their own name."""


class RunCommand(Command):
    """Edit photos of a scene and reconstruct them in 3D."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "images",
            nargs="*",
            metavar="IMAGE|FOLDER|VIDEO",
            help="two or more photos of one scene, or a video of it; default: a packaged pair",
        )
        add(
            "--from",
            dest="earlier",
            metavar="DIR",
            help="edit the scene of an earlier run again (its --out folder)",
        )
        add_setting_flags(parser)
        add_mark_flags(parser)
        add(
            "--config",
            metavar="FILE",
            help="YAML file of run settings, or the name of a shipped one",
        )
        add(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="one setting, such as editor.strength=0.5",
        )
        add(
            "--cameras",
            metavar="FILE",
            help="cameras.json or transforms.json with the photos' intrinsics",
        )
        add(
            "--refine-poses",
            action="store_true",
            help="let the poses of --cameras move to where the photos want them",
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
            default="edit3r-out",
            help="folder for the results (default edit3r-out)",
        )
        add(
            "--overwrite",
            action="store_true",
            help="replace an earlier run in --out even where it was changed by hand",
        )
        add(
            "--strict",
            action="store_true",
            help="end with exit code 1 when the verdict on the result is 'failed'",
        )
        add("--quiet", action="store_true", help="print errors only")
        add(
            "--progress",
            choices=("text", "json"),
            default="text",
            help="json: one line an event, for other programs",
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.cli.console import StageConsole, print_json
        from edit3r.reporting import Report

        gc.set_threshold(
            100_000, 50, 100
        )  # as usual, half a second goes into looking through what modules made
        with (
            nullcontext(print_json)
            if args.progress == "json"
            else StageConsole(quiet=args.quiet) as console
        ):
            result = self._run(args, Report(on_event=console))
        if not args.quiet:
            from edit3r.pipeline.write import summary

            print(summary(Path(args.out), result))
        if args.strict and result.verdict.label == "failed":
            raise RunError(f"the verdict is failed: {result.verdict.reason}")
        return 0

    def _run(self, args: argparse.Namespace, report: "Report") -> "RunResult":
        """Run and write the results, telling `report` from the first second."""
        from edit3r.reporting import collecting

        with (
            collecting(report),
            report.stage("start"),
        ):  # most of it goes into importing torch
            from edit3r.cache import Cache
            from edit3r.io.atomic import atomic_folder
            from edit3r.io.coverage import USUAL_FRAMES
            from edit3r.io.images import find_photos, packaged_pair
            from edit3r.pipeline import steps as pipeline
            from edit3r.pipeline import write as results
            from edit3r.pipeline.earlier import read_earlier_run
            from edit3r.plugins.registry import default_registry

            earlier = read_earlier_run(args.earlier) if args.earlier else None
            continued = (
                earlier if not args.images else None
            )  # photos that are given are edited from the start
            images, cameras = (
                (args.images, args.cameras) if args.images else packaged_pair()
            )
            found = (
                None
                if continued
                else find_photos(images, max(USUAL_FRAMES, args.views or 0))
            )
            paths = found or [Path(record.file) for record in continued.records]
            config = _config(args, len(paths), earlier)
            registry = default_registry(tuple(args.plugin))
            check_names(registry, config)
        with collecting(report), report.stage("read photos"):
            photos, masks, hashes = read_photos(
                paths, config, cameras, args, registry, continued
            )
            if (args.cameras or args.refine_poses) and not continued:
                config = with_known_poses(
                    config, photos.views, registry, args.refine_poses
                )
        with atomic_folder(args.out, args.overwrite) as folder:
            result = pipeline.run(
                photos.views,
                config,
                masks=masks,
                registry=registry,
                report=report,
                cache=Cache(
                    Path(args.earlier) / results.CACHE if args.earlier else None
                ),
                earlier=continued,
            )
            result = replace(result, records=photos.photos, mask_files=hashes)
            results.write(folder, result)
        return result


def read_photos(
    paths: list[Path],
    config: RunConfig,
    cameras: str | Path | None,
    args: argparse.Namespace,
    registry: "Registry",
    continued: "EarlierRun | None" = None,
) -> "tuple[LoadedPhotos, Tensor | Selection | None, dict[str, str]]":
    """Return those of the photos that are used, what is masked or marked on them, and the hashes of
    mask files.

    `args` say the marks (images, earlier, mask, point, not_point, box); the photos of a `continued`
    run are its edits.
    """
    from edit3r.io.atomic import sha256_of
    from edit3r.io.coverage import choose_photos
    from edit3r.io.images import LoadedPhotos, load_photos
    from edit3r.pipeline.quality import note_quality
    from edit3r.pipeline.steps import lens_of

    used = paths if continued else choose_photos(paths, config.views)
    given = args.mask
    if len(given) == len(paths):  # one for each photo, used or not
        given = [mask for mask, path in zip(given, paths) if path in used]
    if continued:
        photos = LoadedPhotos(continued.edited, continued.records)
    else:
        read_lens = partial(lens_of, config, registry)
        photos = load_photos(
            used, fov=config.fov, size=config.size, cameras=cameras, read_lens=read_lens
        )
    masks = _masks_or_marks(args, given, photos, config)
    hashes = {file: sha256_of(Path(file)) for file in given}
    note_quality(config.model_dump(), len(paths))
    return photos, masks, hashes


def with_known_poses(
    config: RunConfig, views: "Views", registry: "Registry", refine: bool = False
) -> RunConfig:
    """The configuration for views whose poses the user gave: they are used as they are, unless a
    matcher was chosen.

    `refine`: they may move to where the photos want them.
    """
    from edit3r.reporting import say

    chosen = config.reconstructor
    has_matcher = (
        "matcher" in registry.find("reconstructor", chosen.name).component.parts
    )
    usable = views.c2w is not None and has_matcher and "matcher" not in chosen.settings
    if refine and not usable:
        raise InputError(
            "--refine-poses: needs --cameras with the poses of all photos, and no other matcher."
        )
    if not usable:
        return config
    say(
        "poses.source",
        "those that were given" + (", as they are" if not refine else ""),
    )
    settings = {
        **chosen.settings,
        **DEFAULTS["refined_poses" if refine else "known_poses"],
    }
    return config.model_copy(
        update={"reconstructor": chosen.model_copy(update={"settings": settings})}
    )


def _masks_or_marks(
    args: argparse.Namespace,
    files: list[str],
    photos: "LoadedPhotos",
    config: RunConfig,
) -> "Tensor | Selection | None":
    """Masks of all photos, or what is marked on some of them; the packaged pair brings a mask of
    its own subject.
    """
    from edit3r.io.masks import load_masks
    from edit3r.reporting import note

    if files and len(files) == len(photos.photos):
        return load_masks(files, photos)
    marked = selection_from(args, photos)
    usual = (
        not args.images
        and not args.earlier
        and config.editor.name == DEFAULTS["editor"]
    )
    if marked is None and usual and DEFAULTS["subject"] in config.prompt.lower():
        note(
            "selection.mask",
            "the packaged pair brings masks of its " + DEFAULTS["subject"],
        )
        own = [
            str(Path(__file__).parents[1] / "io" / f"motorcycle_mask{side}.png")
            for side in ("", "_right")
        ]
        return load_masks(own, photos)
    return marked


def add_setting_flags(parser: argparse.ArgumentParser) -> None:
    """Add one flag for each setting of `RunConfig` that a single word can give."""
    for name, field in RunConfig.model_fields.items():
        if name == "refiners":  # a list with settings: --set refiners=[...]
            continue
        words = (
            ",".join(field.default)
            if isinstance(field.default, tuple)
            else field.default
        )
        default = (
            "" if words in (None, "") else f" (default {getattr(words, 'name', words)})"
        )
        text = f"{field.description}{default}".replace("%", "%%")
        flag = f"--{SHORT_FLAGS.get(name, name).replace('_', '-')}"
        parser.add_argument(flag, dest=name, help=text, **_flag_form(field))


def _flag_form(field: FieldInfo) -> dict[str, Any]:
    """How argparse reads a setting of this type; pydantic checks the value itself."""
    union = typing.get_origin(field.annotation) in (typing.Union, types.UnionType)
    options = typing.get_args(field.annotation) if union else (field.annotation,)
    kinds = [option for option in options if option is not type(None)]
    choices = [
        word
        for kind in kinds
        if typing.get_origin(kind) is typing.Literal
        for word in typing.get_args(kind)
    ]
    if choices:
        return (
            {"choices": choices}
            if len(kinds) == 1
            else {"metavar": "|".join([*choices, "N"])}
        )
    if kinds == [bool]:
        return {"action": "store_const", "const": True}
    if PartChoice in kinds:
        return {"metavar": "NAME"}
    if kinds[0] in (int, float):
        return {"metavar": "N", "type": kinds[0]}
    return {"metavar": "TEXT"}


def _config(
    args: argparse.Namespace, photos: int, earlier: "EarlierRun | None" = None
) -> RunConfig:
    """Merge what the earlier run hands down, the configuration file, `--set`, and the flags, later
    over earlier.
    """
    from edit3r.config import find_config, parse_assignments, read_yaml

    layers: list[dict[str, Any]] = []
    if args.config:
        layers.append(read_yaml(find_config(args.config)))
    layers.append(parse_assignments(args.set))
    flags = {name: getattr(args, name, None) for name in RunConfig.model_fields}
    # A flag names a component; settings that a file or --set gave for it stay.
    layers.append(
        {
            k: {"name": v} if k in PART_KEYS else v
            for k, v in flags.items()
            if v is not None
        }
    )
    if earlier is not None:
        layers.insert(0, _inherited(earlier, layers))
    elif not args.images and not any("prompt" in layer for layer in layers):
        layers.insert(0, {"prompt": DEFAULTS["prompt"]})
    return make_run_config(*layers, photos=photos)


def _inherited(earlier: "EarlierRun", layers: list[dict[str, Any]]) -> dict[str, Any]:
    """The earlier run's frames and, unless another is asked for, its reconstructor."""
    frames = {"frames": earlier.frames}
    named = [layer["reconstructor"] for layer in layers if "reconstructor" in layer]
    named = [
        choice.get("name") if isinstance(choice, dict) else choice for choice in named
    ]
    another = any(name not in (None, earlier.reconstructor["name"]) for name in named)
    wished = any(
        key in layer
        for layer in layers
        for key in ("quality", "budget_ms", "max_gaussians", "max_memory")
    )
    return (
        frames
        if another or wished
        else {**frames, "reconstructor": earlier.reconstructor}
    )


def check_names(registry: "Registry", config: RunConfig) -> None:
    """Unknown names and settings and missing packages end the run before any photo is read."""
    choices = [(kind, getattr(config, kind)) for kind in PART_KEYS]
    choices += [("refiner", choice) for choice in config.all_refiners()]
    for kind, choice in choices:
        if choice is not None:
            registry.check(kind, choice)
