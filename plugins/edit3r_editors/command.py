"""Any program as an editor: it is given image files and told where to write the result.

The command is split into arguments once and never goes through a shell, so a prompt with quotes or
semicolons stays one argument. Placeholders:

| placeholder | becomes |
| --- | --- |
| `{input}`, `{output}` | PNG of one view, and the file to write; once per view |
| `{input_dir}`, `{output_dir}` | folder with one PNG per view, and the one for results |
| `{mask}`, `{mask_dir}` | mask as grey PNG (white may change), all white when the run has none |
| `{prompt}`, `{seed}` | the prompt as it is, the seed as a number |
"""

import shlex
import string
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract import reporting
from edit3r.contract.errors import RunError, SettingsError
from edit3r.contract.interfaces import Editor
from edit3r.contract.settings import USER_ONLY
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.photos.images import save_image
from edit3r_editors.folder import read_edit, view_names

PER_VIEW = ("input", "mask", "output")
TOGETHER = ("input_dir", "mask_dir", "output_dir")
PLACEHOLDERS = (*PER_VIEW, *TOGETHER, "prompt", "seed")
EXAMPLE = '--set editor.command="mytool --in {input} --out {output} --prompt {prompt}"'


class CommandEditor(Editor):
    """Runs `editor.command` per view, or once for all views when it names folders."""

    class Settings(edit3r.Settings):
        command: str = Field("", json_schema_extra=USER_ONLY)
        """program with arguments; {input} {output} {mask} {prompt} {seed}, or *_dir"""
        timeout: float = Field(600, gt=0)
        """time limit of one call [seconds]"""

    settings: Settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        masks, names = request.masks, view_names(views)
        if masks is None:
            masks = torch.ones_like(views.images[:, :, 0])
        scenes = zip(views.images, masks)
        edited = [self._edit_scene(*scene, names, request) for scene in scenes]
        return replace(views, images=torch.stack(edited))

    def _edit_scene(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "view height width"],
        names: list[str],
        request: EditRequest,
    ) -> Float[Tensor, "view 3 height width"]:
        """Run the program on a scene's views. Raises RunError where it fails or leaves one out."""
        arguments, together = parse_command(self.settings.command)
        with tempfile.TemporaryDirectory(prefix="edit3r-command-") as folder:
            folders = {kind: Path(folder, kind) for kind in PER_VIEW}
            for made in folders.values():
                made.mkdir()
            for name, image, mask in zip(names, images, masks):
                save_image(image, folders["input"] / f"{name}.png")
                save_image(mask.expand(3, -1, -1), folders["mask"] / f"{name}.png")
            calls = [{f"{kind}_dir": made for kind, made in folders.items()}]
            if not together:
                calls = [
                    {kind: made / f"{name}.png" for kind, made in folders.items()}
                    for name in names
                ]
            for files in reporting.track(calls, "external program"):
                words = {**files, "prompt": request.prompt, "seed": request.seed}
                filled = [argument.format(**words) for argument in arguments]
                self._call(filled, Path(folder) / "log.txt")
            outputs = [folders["output"] / f"{name}.png" for name in names]
            missing = next((file.name for file in outputs if not file.is_file()), None)
            if missing is not None:
                written = sorted(file.name for file in folders["output"].iterdir())
                raise RunError(
                    f"editor.command: {arguments[0]!r} ended without an error but did not write "
                    f"{missing}; it wrote {', '.join(written) or 'nothing'}. Write PNG files to "
                    "the path it is given."
                )
            return torch.stack([read_edit(*one) for one in zip(outputs, images, names)])

    def _call(self, command: list[str], log: Path) -> None:
        program, limit = command[0], self.settings.timeout
        try:
            # Into a file: with a pipe, a grandchild that outlives the time limit would keep us
            # waiting for its end.
            with log.open("wb") as said:
                done = subprocess.run(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=said,
                    stderr=subprocess.STDOUT,
                    timeout=limit,
                )
        except FileNotFoundError:
            raise RunError(
                f"editor.command: no program {program!r} found; give its full path."
            ) from None
        except PermissionError:
            raise RunError(
                f"editor.command: {program!r} may not be executed."
            ) from None
        except subprocess.TimeoutExpired:
            raise RunError(
                f"editor.command: {program!r} ran longer than {limit:g} s and was ended; raise "
                "editor.timeout if it needs more."
            ) from None
        if done.returncode != 0:
            text = log.read_text(encoding="utf-8", errors="replace")
            reason = " ".join(text.split())[-400:] or "it printed nothing"
            raise RunError(
                f"editor.command: {program!r} failed with exit code {done.returncode}: {reason}"
            )


def parse_command(command: str) -> tuple[list[str], bool]:
    """Arguments with placeholders, and whether one call edits all views. Raises SettingsError."""
    try:
        arguments = shlex.split(command)
        read = string.Formatter().parse
        parsed = [part for argument in arguments for part in read(argument)]
    except ValueError as error:
        raise SettingsError(
            f"editor.command: cannot be split into arguments ({error}), got {command!r}."
        ) from None
    if not arguments:
        raise SettingsError(
            f"editor.command: the editor 'command' needs a program, for example {EXAMPLE}."
        )
    # a literal brace is written twice
    used = [name for _, name, _, _ in parsed if name is not None]
    unknown = [name for name in used if name not in PLACEHOLDERS]
    if unknown:
        listed = ", ".join(f"{{{name}}}" for name in PLACEHOLDERS)
        raise SettingsError(
            f"editor.command: unknown placeholder {{{unknown[0]}}}; known are {listed}."
        )
    together = not set(used).isdisjoint(TOGETHER)
    if together and not set(used).isdisjoint(PER_VIEW):
        raise SettingsError(
            "editor.command: {input}, {output} and {mask} do not go with their _dir forms; use "
            "one kind."
        )
    if ("output_dir" if together else "output") not in used:
        raise SettingsError(
            f"editor.command: it must say where to write, for example {EXAMPLE}."
        )
    return arguments, together
