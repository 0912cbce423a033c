"""`edit3r run`: photos in, an edited 3D scene out."""

import argparse
import gc
import shlex
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edit3r.contract.command import Command
from edit3r.contract.errors import (
    Edit3rError,
    InputError,
    QuestionError,
    RunError,
    as_known,
)
from edit3r.kit.command.flags import add_common, add_trust_flag
from edit3r.kit.files.names import require_there
from edit3r.running.config import PART_KEYS, JobInputs, RunConfig
from edit3r.running.flags import INPUTS, add_flags, add_mark_flags, given_flags

if TYPE_CHECKING:
    from edit3r.contract.reporting import Report
    from edit3r.contract.types import Views
    from edit3r.running.job import RunJob
    from edit3r.running.result import RunResult


PREVIEW = "edit3r-preview.png"


class RunCommand(Command):
    """Edit photos of a scene and reconstruct them in 3D."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        add(
            "photos",
            nargs="*",
            metavar="IMAGE|FOLDER|VIDEO|SCENE",
            help="two or more photos of one scene, or a video of it; or a scene itself (.ply, "
            ".spz, .sog, .splat, .glb); default: a packaged pair",
        )
        add("--from", dest="earlier", metavar="DIR", help=INPUTS["earlier"])
        add_flags(parser, RunConfig)
        add_mark_flags(parser)
        add("--cameras", metavar="FILE", help=INPUTS["cameras"])
        add("--refine-poses", action="store_true", help=INPUTS["refine_poses"])
        add(
            "--config",
            metavar="FILE",
            help="YAML file of run settings, or the name of a shipped one",
        )
        add_trust_flag(parser)
        add_common(
            parser,
            settings="one setting, such as editor.strength=0.5",
            overwrite="replace an earlier run in --out even where it was changed by hand",
        )
        add(
            "--out",
            metavar="DIR",
            default="edit3r-out",
            help="folder for the results (default edit3r-out)",
        )
        add(
            "--preview",
            metavar="FILE",
            nargs="?",
            const=PREVIEW,
            help="only show, in an image file, what is selected and how it is edited in 2D "
            f"(default {PREVIEW})",
        )
        add(
            "--strict",
            action="store_true",
            help="end with exit code 1 when the verdict on the result is 'failed'",
        )
        add(
            "--progress",
            choices=("text", "json"),
            default="text",
            help="json: one line an event, for other programs",
        )

    def configuration(self) -> type[RunConfig]:
        return RunConfig

    def main(self, args: argparse.Namespace) -> int:
        for path in args.photos if args.preview is None else ():
            require_there(path)  # before torch is imported, which takes seconds
        from edit3r.contract.reporting import Report
        from edit3r.kit.command.console import StageConsole, print_json

        # As usual, half a second goes into looking through what modules made.
        gc.set_threshold(100_000, 50, 100)
        as_text = StageConsole(args.quiet)
        as_json = nullcontext(print_json)
        with as_text if args.progress == "text" else as_json as console:
            report = Report(on_event=console)
            if args.preview is not None:
                return self._preview(args, report)
            result = self._run(args, report)
        if not args.quiet:
            from edit3r.running.summary import summary

            print(summary(Path(args.out), result))
        if args.strict and result.verdict.label == "failed":
            raise RunError(f"the verdict is failed: {result.verdict.reason}")
        return 0

    def _preview(self, args: argparse.Namespace, report: "Report") -> int:
        """Write the sheet of the 2D edit."""
        from edit3r.contract.reporting import collecting

        with collecting(report), report.stage("start"):
            import numpy as np

            from edit3r.kit.files.atomic import check_new_file
            from edit3r.kit.photos.images import save_pixels
            from edit3r.loading.registry import default_registry
            from edit3r.running.pipeline import preview
            from edit3r.running.result import preview_sheet
            from edit3r.running.summary import answers

            # `--preview a.jpg b.jpg` would take the first photo for the file to write.
            check_new_file(args.preview, args.overwrite or args.preview == PREVIEW)
            _check_preview(Path(args.preview), args.photos)
            job = _job(args)
            registry = default_registry(tuple(args.plugin))
        made = preview(job, registry, report)
        sheet = np.asarray(preview_sheet(made, job.config.prompt))
        save_pixels(sheet, args.preview, is_photo=False)
        if not args.quiet:
            edit = None if made.edit is None else made.edit.verdict
            for line in answers(made.selection, edit):
                print(line)
            print(f"look at {args.preview}; nothing is reconstructed yet")
        return 0

    def _run(self, args: argparse.Namespace, report: "Report") -> "RunResult":
        """Run and write the results, telling `report` from the first second."""
        from edit3r.contract.reporting import collecting

        # most of it goes into importing torch
        with (
            collecting(report),
            report.stage("start"),
        ):
            from edit3r.kit.files.atomic import atomic_folder, check_apart
            from edit3r.loading.registry import default_registry
            from edit3r.running.pipeline import run
            from edit3r.running.result import write_result

            check_apart(args.out, *map(Path, (*args.photos, *args.mask)))
            job = _job(args)
            registry = default_registry(tuple(args.plugin))
        edited: list[Views] = []
        try:
            with atomic_folder(args.out, args.overwrite) as folder:
                result = run(job, registry, report, on_edited=edited.append)
                write_result(folder, result)
        except QuestionError as question:
            raise _with_sheet(question, Path(args.out), job.config.prompt) from None
        except Exception as error:
            if not edited:
                raise
            raise _with_edits_kept(error, Path(args.out), edited[0]) from error
        return result


def _with_sheet(question: QuestionError, out: Path, prompt: str) -> QuestionError:
    """The question, once its numbered candidates are drawn beside `out`."""
    import numpy as np

    from edit3r.kit.photos.images import save_pixels
    from edit3r.running.result import preview_sheet

    file = out.with_name(f"{out.name}-question.png")
    sheet = np.asarray(preview_sheet(question.preview, prompt))
    save_pixels(sheet, file, is_photo=False)
    return QuestionError(f"{question} Look at {file}.", question.candidates)


def _with_edits_kept(error: Exception, out: Path, edited: "Views") -> Edit3rError:
    """The error, once the edited photos are beside `out`: an editor may take minutes, or money."""
    from edit3r.kit.files.atomic import atomic_folder
    from edit3r.kit.photos.images import save_image

    known, kept = as_known(error), out.with_name(f"{out.name}-edits")
    with suppress(Edit3rError, OSError):
        with atomic_folder(kept) as folder:
            for name, image in zip(edited.names, edited.images[0]):
                save_image(image, folder / f"{name}.png")
        again = f"--editor folder --set editor.path={shlex.quote(str(kept))}"
        return type(known)(
            f"{known} The edited photos are in {kept}; go on from them with {again}."
        )
    return known


def _check_preview(file: Path, photos: list[str]) -> None:
    """Raise InputError for a file that would be no image, or that is one of the photos."""
    from edit3r.kit.photos.images import find_photos
    from edit3r.kit.photos.temporary import temporary_photos
    from edit3r.running.job import scene_among

    if file.suffix.lower() not in (".png", ".jpg", ".jpeg", ".webp"):
        raise InputError(
            f"--preview {file}: expected the name of an image, such as look.png."
        )
    if file.exists() and photos and scene_among(photos) is None:
        with temporary_photos():
            used = {photo.resolve() for photo in find_photos(photos)}
        if file.resolve() in used:
            raise InputError(
                f"--preview {file}: this is one of the photos; give another name."
            )


def _job(args: argparse.Namespace) -> "RunJob":
    """The job that the arguments describe: file, `--set` and flags, later over earlier."""
    from edit3r.contract.settings import make_settings
    from edit3r.kit.files.configs import parse_assignments, read_config
    from edit3r.running.job import job_from

    layers: list[dict[str, Any]] = []
    if args.config:
        layers.append(read_config(args.config, args.trust_config))
    layers.append(parse_assignments(args.set))
    # A flag names a component; settings that a file or --set gave for it stay.
    flags = given_flags(args, RunConfig)
    layers.append({k: {"name": v} if k in PART_KEYS else v for k, v in flags.items()})
    words = {name: getattr(args, name) for name in JobInputs.model_fields}
    inputs = make_settings(JobInputs, words, where="run")
    return job_from(inputs, *layers, trusted=args.trust_config)
