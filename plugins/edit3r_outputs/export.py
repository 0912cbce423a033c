"""`edit3r export`: a saved scene by any writer; scenes of other programs as PLY."""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.settings import PartChoice
from edit3r.kit.command.flags import add_common
from edit3r.kit.command.results import shown_stages
from edit3r.kit.scenes.files import scene_file

if TYPE_CHECKING:
    from edit3r import Registry


class ExportCommand(Command):
    """Write a saved scene for people or other programs; a file of theirs can be read as well."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        from edit3r import default_registry

        offers = default_registry().offers("writer")
        writers = ", ".join(offer.component.name for offer in offers)
        add = parser.add_argument
        about = "folder of a run, or a scene's .ply, .compressed.ply, .spz, .sog, .splat or .glb"
        add("scene", type=scene_file, metavar="SCENE", help=about)
        about = f"{writers} (see edit3r list-plugins --kind writer)"
        add("--to", required=True, nargs="+", metavar="WRITER", help=about)
        about = "the file or folder to write, for one writer; default: beside the scene"
        add("--out", metavar="PATH", help=about)
        add_common(
            parser,
            settings="a setting of a writer, such as writer.video.fps=30",
            overwrite="replace files that are there",
        )

    def main(self, args: argparse.Namespace) -> int:

        from edit3r import default_registry
        from edit3r.kit.files.atomic import check_new_file
        from edit3r_outputs.saved import SavedScene, write_saved

        if args.out and len(args.to) > 1:
            raise InputError(
                "--out names one file or folder; give one writer with it, or omit --out."
            )
        registry = default_registry(tuple(args.plugin))
        saved = SavedScene(args.scene, registry)
        choices = _choices(dict.fromkeys(args.to), args.set)
        writers = [registry.build_choice("writer", one) for one in choices]
        if args.out:
            _check_ending(args.out, args.to[0], registry)
        writers_built = {}
        for writer in writers:
            name = writer.offer.component.file_name(saved.stem)
            writers_built[writer] = Path(args.out or args.scene.with_name(name))
            check_new_file(writers_built[writer], args.overwrite, source=args.scene)
        with shown_stages(args.quiet) as report:
            with report.stage("read scene"):
                _ = saved.gaussians
            for writer, path in writers_built.items():
                with report.stage(f"write {writer.offer.component.name}"):
                    write_saved(writer, path, saved, args.overwrite)
        if not args.quiet:
            for path in writers_built.values():
                size = sum(file.stat().st_size for file in (path, *path.rglob("*")))
                print(f"wrote {path} ({size / 1e6:.1f} MB)")
        return 0


def _check_ending(out: str, name: str, registry: "Registry") -> None:
    """Raise InputError for a file of one writer that is named as one of another."""
    named = {
        one.component.name: one.component.suffix.lower()
        for one in registry.offers("writer")
    }
    fits = [
        other for other, suffix in named.items() if out.lower().endswith(suffix or "/")
    ]
    longest = max((named[other] for other in fits), key=len, default="")
    own = named.get(name.rpartition(":")[2], "")
    if (
        own
        and longest
        and "." in own
        and longest.rpartition(".")[2] != own.rpartition(".")[2]
    ):
        other = next(one for one in fits if named[one] == longest)
        raise InputError(
            f"--out {out}: --to {name} writes a file that ends in {own}; write --to {other}, or "
            "give another --out."
        )


def _choices(names: Iterable[str], assignments: Iterable[str]) -> list[PartChoice]:
    """The writers with what is set for them; raises SettingsError for settings of others."""
    from edit3r.kit.files.configs import parse_assignments

    names = tuple(names)
    given = parse_assignments(assignments)
    settings = given.pop("writer", {})
    wrong = [*given, *(f"writer.{name}" for name in settings if name not in names)]
    if wrong or not all(isinstance(one, dict) for one in settings.values()):
        raise SettingsError(
            f"--set {wrong[0] if wrong else 'writer'}: expected writer.NAME.SETTING=VALUE of a "
            f"writer in --to ({', '.join(names)}), such as writer.{names[0]}.SETTING=VALUE."
        )
    return [PartChoice(name=name, settings=settings.get(name, {})) for name in names]
