"""Any program as an editor: it is given image files and told where to write the result.

The command is split into arguments once and never goes through a shell, so a prompt with quotes or semicolons stays
one argument. Placeholders:

| placeholder                   | becomes                                                                       |
|-------------------------------|-------------------------------------------------------------------------------|
| `{input}`, `{output}`         | PNG of one view, and the file to write; the program runs once per view        |
| `{input_dir}`, `{output_dir}` | folder with one PNG per view, and the folder for results of the same names    |
| `{mask}`, `{mask_dir}`        | mask as grey PNG (white may change), all white when the run has none          |
| `{prompt}`, `{seed}`          | the prompt as it is, the seed as a number                                     |
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

PER_VIEW = {"input", "output", "mask"}
TOGETHER = {"input_dir", "output_dir", "mask_dir"}
ALWAYS = {"prompt", "seed"}
EXAMPLE = '--set editor.command="mytool --in {input} --out {output} --prompt {prompt}"'


class CommandEditor(Editor):
    """Runs `editor.command` per view, or once for all views when it names folders."""

    class Settings(Settings):
        command: str = Field(
            "", description="program with arguments; {input} {output} {mask} {prompt} {seed}, or *_dir"
        )
        timeout: float = Field(600, gt=0, description="time limit of one call [seconds]")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def edit(self, views: Views, request: EditRequest) -> Views:
        arguments, together = parse_command(self.settings.command)
        images = []
        for scene in range(len(views.images)):
            masks = torch.ones_like(views.images[scene, :, 0]) if request.masks is None else request.masks[scene]
            with tempfile.TemporaryDirectory(prefix="edit3r-command-") as folder:
                job = _Job(Path(folder), view_names(views), arguments, request, self.settings.timeout)
                job.write(views.images[scene], masks)
                job.run_once() if together else job.run_per_view()
                images.append(job.read(views.images[scene]))
        return replace(views, images=torch.stack(images))


class _Job:
    """The files and calls of one scene, in a temporary folder."""

    def __init__(
        self, folder: Path, names: list[str], arguments: list[str], request: EditRequest, timeout: float
    ) -> None:
        self.names, self.arguments, self.timeout = names, arguments, timeout
        self.folders = {kind: folder / kind for kind in ("input", "output", "mask")}
        for made in self.folders.values():
            made.mkdir()
        self.log = folder / "log.txt"
        self.values = {"prompt": request.prompt, "seed": request.seed}

    def write(self, images: Float[Tensor, "view 3 height width"], masks: Float[Tensor, "view height width"]) -> None:
        """Write the program's input: images and grey masks."""
        for name, image, mask in zip(self.names, images, masks):
            save_image(image, self.folders["input"] / f"{name}.png")
            save_image(mask.expand(3, -1, -1), self.folders["mask"] / f"{name}.png")

    def run_per_view(self) -> None:
        """Run the program once for every view."""
        for name in reporting.track(self.names, "external program"):
            self._call({kind: str(folder / f"{name}.png") for kind, folder in self.folders.items()})

    def run_once(self) -> None:
        """Run the program once for all views."""
        self._call({f"{kind}_dir": str(folder) for kind, folder in self.folders.items()})

    def read(self, like: Float[Tensor, "view 3 height width"]) -> Float[Tensor, "view 3 height width"]:
        """Read what the program wrote, at the size of `like`. Raises RunError when something is missing."""
        outputs = self.folders["output"]
        files = [outputs / f"{name}.png" for name in self.names]
        missing = next((file.name for file in files if not file.is_file()), None)
        if missing is not None:
            written = ", ".join(sorted(file.name for file in outputs.iterdir())) or "nothing"
            raise RunError(
                f"editor.command: {self.arguments[0]!r} ended without an error but did not write "
                f"{missing}; it wrote {written}. Write PNG files to the path it is given."
            )
        return torch.stack([read_edit(file, image, name) for file, image, name in zip(files, like, self.names)])

    def _call(self, files: dict[str, str]) -> None:
        filled = [argument.format(**self.values, **files) for argument in self.arguments]
        try:
            # Into a file: with a pipe, a grandchild that outlives the time limit would keep us waiting for its end.
            with self.log.open("wb") as log:
                done = subprocess.run(
                    filled, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, timeout=self.timeout
                )
        except FileNotFoundError:
            raise RunError(f"editor.command: no program {filled[0]!r} found; give its full path.") from None
        except PermissionError:
            raise RunError(f"editor.command: {filled[0]!r} may not be executed.") from None
        except subprocess.TimeoutExpired:
            raise RunError(
                f"editor.command: {filled[0]!r} ran longer than {self.timeout:g} s and was ended; "
                f"raise editor.timeout if it needs more."
            ) from None
        if done.returncode != 0:
            said = _tail(self.log.read_bytes())
            raise RunError(f"editor.command: {filled[0]!r} failed with exit code {done.returncode}: {said}")


def parse_command(command: str) -> tuple[list[str], bool]:
    """Split a command into arguments with placeholders; True: one call edits all views. Raises SettingsError."""
    try:
        arguments = shlex.split(command)
        used = {name for argument in arguments for name in _placeholders(argument)}
    except ValueError as error:
        raise SettingsError(f"editor.command: cannot be split into arguments ({error}), got {command!r}.") from None
    if not arguments:
        raise SettingsError(f"editor.command: the editor 'command' needs a program, for example {EXAMPLE}.")
    known = sorted(PER_VIEW | TOGETHER | ALWAYS)
    unknown = sorted(used.difference(known))
    if unknown:
        listed = ", ".join("{" + name + "}" for name in known)
        raise SettingsError(f"editor.command: unknown placeholder {{{unknown[0]}}}; known are {listed}.")
    together = bool(used & TOGETHER)
    if together and used & PER_VIEW:
        raise SettingsError(
            "editor.command: {input}, {output} and {mask} do not go with their _dir forms; use one kind."
        )
    if ("output_dir" if together else "output") not in used:
        raise SettingsError(f"editor.command: it must say where to write, for example {EXAMPLE}.")
    return arguments, together


def _placeholders(argument: str) -> list[str]:
    """List the names in braces; raises ValueError for unbalanced braces (a literal one is written twice)."""
    return [name for _, name, _, _ in string.Formatter().parse(argument) if name is not None]


def _tail(log: bytes, characters: int = 400) -> str:
    """Return the last characters of what a program printed, on one line."""
    text = " ".join(log.decode("utf-8", errors="replace").split())
    if not text:
        return "it printed no message."
    return text if len(text) <= characters else f"... {text[-characters:]}"
