"""Any program as an editor: for each view it is given image files and told where to write the result.

The command is split into arguments once and never goes through a shell, so a prompt with quotes or semicolons stays
one argument. Placeholders:

| placeholder          | becomes                                                          |
|----------------------|------------------------------------------------------------------|
| `{input}`            | PNG of one view                                                  |
| `{output}`           | the file to write                                                |
| `{mask}`             | grey PNG (white may change), all white when the run has no mask  |
| `{prompt}`, `{seed}` | the prompt as it is, the seed as a number                        |
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

from edit3r import reporting
from edit3r.config import Settings
from edit3r.errors import RunError, SettingsError
from edit3r.interfaces import Editor
from edit3r.io.images import save_image
from edit3r.types import EditRequest, Views
from edit3r_editors.folder import read_edit, view_names

PLACEHOLDERS = ("input", "mask", "output", "prompt", "seed")
EXAMPLE = '--set editor.command="mytool --in {input} --out {output} --prompt {prompt}"'


class CommandEditor(Editor):
    """Runs `editor.command` once for every view."""

    class Settings(Settings):
        command: str = Field("", description="program with arguments; {input} {output} {mask} {prompt} {seed}")
        timeout: float = Field(600, gt=0, description="time limit of one call [seconds]")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        arguments, images = parse_command(self.settings.command), torch.empty_like(views.images)
        for scene in range(len(images)):
            for view, name in enumerate(reporting.track(view_names(views), "external program")):
                mask = None if request.masks is None else request.masks[scene, view]
                images[scene, view] = self._edit_view(arguments, views.images[scene, view], mask, name, request)
        return replace(views, images=images)

    def _edit_view(
        self,
        arguments: list[str],
        image: Float[Tensor, "3 height width"],
        mask: Float[Tensor, "height width"] | None,
        name: str,
        request: EditRequest,
    ) -> Float[Tensor, "3 height width"]:
        """Run the program on one view. Raises RunError where it fails or writes nothing."""
        with tempfile.TemporaryDirectory(prefix="edit3r-command-") as folder:
            files = {kind: Path(folder, kind, f"{name}.png") for kind in ("input", "output", "mask")}
            for file in files.values():
                file.parent.mkdir()
            save_image(image, files["input"])
            save_image((torch.ones_like(image[0]) if mask is None else mask).expand(3, -1, -1), files["mask"])
            filled = [a.format(**files, prompt=request.prompt, seed=request.seed) for a in arguments]
            self._call(filled, Path(folder) / "log.txt")
            if not files["output"].is_file():
                written = ", ".join(sorted(file.name for file in files["output"].parent.iterdir())) or "nothing"
                raise RunError(
                    f"editor.command: {arguments[0]!r} ended without an error but did not write {name}.png; it wrote "
                    f"{written}. Write a PNG file to the path it is given."
                )
            return read_edit(files["output"], image, name)

    def _call(self, command: list[str], log: Path) -> None:
        program, limit = command[0], self.settings.timeout
        try:
            # Into a file: with a pipe, a grandchild that outlives the time limit would keep us waiting for its end.
            with log.open("wb") as said:
                done = subprocess.run(
                    command, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, timeout=limit
                )
        except FileNotFoundError:
            raise RunError(f"editor.command: no program {program!r} found; give its full path.") from None
        except PermissionError:
            raise RunError(f"editor.command: {program!r} may not be executed.") from None
        except subprocess.TimeoutExpired:
            raise RunError(
                f"editor.command: {program!r} ran longer than {limit:g} s and was ended; raise editor.timeout if it "
                "needs more."
            ) from None
        if done.returncode != 0:
            text = " ".join(log.read_text(encoding="utf-8", errors="replace").split())[-400:]
            reason = text or "it printed nothing"
            raise RunError(f"editor.command: {program!r} failed with exit code {done.returncode}: {reason}")


def parse_command(command: str) -> list[str]:
    """Split a command into arguments with placeholders. Raises SettingsError where it cannot work."""
    try:
        arguments = shlex.split(command)
        parsed = [part for argument in arguments for part in string.Formatter().parse(argument)]
    except ValueError as error:
        raise SettingsError(f"editor.command: cannot be split into arguments ({error}), got {command!r}.") from None
    if not arguments:
        raise SettingsError(f"editor.command: the editor 'command' needs a program, for example {EXAMPLE}.")
    used = [name for _, name, _, _ in parsed if name is not None]  # a literal brace is written twice
    unknown = [name for name in used if name not in PLACEHOLDERS]
    if unknown:
        listed = ", ".join(f"{{{name}}}" for name in PLACEHOLDERS)
        raise SettingsError(f"editor.command: unknown placeholder {{{unknown[0]}}}; known are {listed}.")
    if "output" not in used:
        raise SettingsError(f"editor.command: it must say where to write, for example {EXAMPLE}.")
    return arguments
