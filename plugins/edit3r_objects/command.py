"""`edit3r objects`: list, make and edit the objects of a finished scene."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError, SettingsError
from edit3r.kit.command.flags import OVERWRITE, add_output_flags
from edit3r.kit.scenes.files import scene_file
from edit3r.running import add_mark_flags

if TYPE_CHECKING:
    from torch import Tensor

    from edit3r.contract.types import Gaussians
    from edit3r_objects.run import Run

DRAWN = ("cut", "crop")
"""Actions on what is drawn: away with it, or with all else."""
NAMELESS = ("list", "find", "clean", *DRAWN)
"""Actions that take no name."""
MEASURE = "measure"
"""Takes a length in place of a name."""
VALUES = {
    **dict.fromkeys((*NAMELESS, "add", "remove", "isolate", MEASURE), ""),
    "rename": "NEW_NAME",
    "recolor": "COLOUR",
    "move": "RIGHT UP NEARER",
    "turn": "DEGREES",
    "scale": "FACTOR",
    "copy": "NEW_NAME RIGHT UP NEARER",
}
"""What follows the name of the object."""
MAX_NUMBER = 1000  # of a step, an angle or a factor


class ObjectsCommand(Command):
    """Take hold of things in a finished scene: remove, move, recolour, copy."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "run", type=Path, metavar="RUN", help="folder of a run, or its scene's file"
        )
        about = (
            "what to do (default list); find: look for the things of the scene; clean: take out "
            "floaters; measure: give the scene's unit, by a length in it (as the viewer measures) "
            "and the true one, such as 3.58=69.4cm"
        )
        add("action", nargs="?", choices=VALUES, default="list", help=about)
        add("name", nargs="?", default="", metavar="NAME", help="of the object")
        takes = (f"{name}: {values}" for name, values in VALUES.items() if values)
        add("values", nargs="*", metavar="VALUE", help="; ".join(takes))
        add_mark_flags(parser)
        about = "for cut, crop and add: what was drawn over the scene, as JSON (docs/objects.md)"
        add("--drawn", metavar="FILE", help=about)
        add("--out", metavar="DIR", help="folder for the new run; RUN is never changed")
        add_output_flags(parser, OVERWRITE)

    def main(self, args: argparse.Namespace) -> int:
        import torch

        from edit3r import default_registry
        from edit3r.kit.files.atomic import atomic_folder, check_apart
        from edit3r_objects.run import describe, read_run, write_run

        numbers = _numbers(args)
        rasterizer = default_registry().build("rasterizer", "auto")
        run = read_run(args.run)
        if args.action == "list":
            print("\n".join(describe(run, rasterizer)))
            return 0
        if not args.out:
            raise SettingsError(f"{args.action}: give --out a folder for the new run.")
        check_apart(args.out, scene_file(str(args.run)), *map(Path, args.mask))
        with torch.no_grad(), atomic_folder(args.out, args.overwrite) as folder:
            new = _edited(run, args, numbers, rasterizer)
            write_run(folder, run, new, rasterizer)
        if not args.quiet:
            if args.action == "find":
                print("\n".join(describe(new, rasterizer)))
            if new.guessed:
                print(
                    f"{new.guessed:,} Gaussians are guesses: no photo shows what the object hid."
                )
            print(f"wrote {args.out}; look at {Path(args.out) / 'before_after.png'}")
        return 0


def _numbers(args: argparse.Namespace) -> tuple[float, ...]:
    """The numbers among the values; raises SettingsError for what the action cannot take."""
    expected = VALUES[args.action].split()
    usage = f"edit3r objects RUN {args.action} NAME {VALUES[args.action]}".strip()
    if len(args.values) != len(expected) and args.action != "recolor":
        raise SettingsError(f"{args.action}: expected {usage}.")
    _check_name(args, usage)
    if args.action == "recolor" and not args.values:
        raise SettingsError(f"recolor: name a colour: {usage}.")
    given = {"move": args.values, "turn": args.values, "scale": args.values}
    texts = given.get(args.action, args.values[1:] if args.action == "copy" else [])
    try:
        numbers = tuple(map(float, texts))
    except ValueError:
        raise SettingsError(f"{args.action}: expected numbers: {usage}.") from None
    if not all(abs(number) <= MAX_NUMBER for number in numbers):
        raise SettingsError(
            f"{args.action}: expected numbers from -{MAX_NUMBER} to {MAX_NUMBER}."
        )
    if args.action == "scale" and not numbers[0] >= 1 / MAX_NUMBER:
        raise SettingsError(
            f"scale: expected a factor of at least 0.001, got {texts[0]}."
        )
    return numbers


def _check_name(args: argparse.Namespace, usage: str) -> None:
    """Raise SettingsError for a name where none is taken, for a missing one, and for strokes that
    are missing or not wanted.
    """
    action = args.action
    if action in NAMELESS and args.name:
        raise SettingsError(f"{action} takes no name: {usage.replace(' NAME', '')}.")
    if action == MEASURE and not args.name:
        raise SettingsError(
            "measure: give a length of the scene and the true one, such as edit3r objects RUN "
            "measure 3.58=69.4cm."
        )
    if action not in NAMELESS and not args.name:
        raise SettingsError(f"{action}: name the object: {usage}.")
    if action in DRAWN and not args.drawn:
        raise SettingsError(f"{action}: expected --drawn FILE, see docs/objects.md.")
    if args.drawn and action not in (*DRAWN, "add"):
        raise SettingsError(f"--drawn: {action} does not take it.")


def _edited(
    run: "Run", args: argparse.Namespace, numbers: tuple[float, ...], rasterizer: Any
) -> "Run":
    """The run after the action."""
    from dataclasses import replace

    import torch

    from edit3r.contract.types import Gaussians
    from edit3r_objects import edits
    from edit3r_objects.holes import without_object

    done = " ".join((args.action, args.name, *args.values)).strip()
    run = replace(run, edits=(*run.edits, done))
    if args.action in (*NAMELESS, "add", MEASURE):
        return _of_the_scene(run, args, rasterizer)
    scene = run.gaussians
    chosen = run.chosen(args.name)
    if args.action not in ("rename", "remove") and not chosen.any():
        raise InputError(
            f"{args.name}: none of its Gaussians is left; remove it, or add it again."
        )
    if args.action == "isolate":
        only = {args.name: run.names[args.name]}
        return replace(run, gaussians=scene.select(chosen), names=only)
    if args.action == "rename":
        run = run.named(args.values[0], run.names[args.name])
        return run.without(args.name, scene)
    if args.action == "recolor":
        return replace(run, gaussians=_changed(scene, chosen, args, numbers))
    if args.action != "copy":
        rest, guessed = without_object(scene, chosen, run.cameras, rasterizer)
        run = replace(run, guessed=guessed)
        if args.action == "remove":
            return run.without(args.name, rest)
    own = edits.in_view_0(
        scene,
        chosen,
        run.cameras,
        run.up,
        lambda one: _changed(one, chosen, args, numbers),
    )
    if args.action == "copy":
        run, rest = run.named(args.values[0], run.free), scene
        index = torch.full_like(own.objects, run.names[args.values[0]])
        own = replace(own, object_index=index)
    return replace(run, gaussians=Gaussians.cat([rest, own]))


def _of_the_scene(run: "Run", args: argparse.Namespace, rasterizer: Any) -> "Run":
    """The run after an action that is about no object that is there."""
    from dataclasses import replace

    from edit3r_objects.run import (
        add_object,
        find_objects,
        in_metres,
        what_is_drawn,
        without_floaters,
    )

    if args.action == "add":
        return add_object(run, args, rasterizer)
    if args.action == MEASURE:
        return in_metres(run, args.name)
    if args.action == "find":
        return find_objects(run, rasterizer)
    if args.action == "clean":
        return replace(run, gaussians=without_floaters(run, rasterizer))
    drawn = what_is_drawn(run, Path(args.drawn), rasterizer)
    chosen = drawn if args.action == "crop" else ~drawn
    return replace(run, gaussians=run.gaussians.select(chosen))


def _changed(
    scene: "Gaussians",
    chosen: "Tensor",
    args: argparse.Namespace,
    numbers: tuple[float, ...],
) -> "Gaussians":
    """The scene with the chosen Gaussians painted, moved, turned or scaled."""
    from edit3r import default_registry
    from edit3r_objects import edits

    if args.action == "recolor":
        editor = default_registry().build("editor", "recolor")
        return edits.painted(scene, chosen, " ".join(args.values), editor)
    if args.action in ("move", "copy"):
        return edits.moved(scene, chosen, numbers)
    if args.action == "turn":
        return edits.turned(scene, chosen, numbers[0])
    return edits.scaled(scene, chosen, numbers[0])
