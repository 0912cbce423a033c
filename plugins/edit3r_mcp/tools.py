"""The tools of the server. Each is one command of edit3r in a process of its own, which ends where
the assistant cancels the call, and writes whole folders or nothing.
"""

import inspect
import io
import json
import os
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from itertools import count
from pathlib import Path
from subprocess import DEVNULL
from tempfile import TemporaryDirectory
from typing import TypeVar

import anyio
from mcp.server.mcpserver import Context, Image, MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from pydantic import BaseModel, Field

from edit3r import default_registry
from edit3r.contract.component import Component
from edit3r.kit.children import PYTHON
from edit3r.kit.files.text import read_json
from edit3r.kit.photos.decode import read_image

TOLD_EVERY = 3.0  # assistants give up after a minute without a sign [s]; a sanity limit
MAX_SIDE = 1600  # of an image that is sent [pixels]: assistants reduce larger ones
INSTRUCTIONS = (
    "Edits 3D scenes from two or more photos of one place. Show what a click or words select with "
    "`select`, then call `edit` with the same marks; tell the user the three answers (what was "
    "selected, how the edit was carried out, whether the scene holds); ask where the selection "
    "is a 'question', and say so where edit or scene is not 'good'."
)
ANSWERS = (
    ("selected", "selection_verdict"),
    ("edit", "edit_verdict"),
    ("scene", "verdict"),
)
"""How a run's three answers are called, and where run.json has them."""
PLACE = "on the first photo, or `N:...` on photo N; in shares of its sides or pixels"


Answer = TypeVar("Answer")


class MarkArguments(BaseModel):
    """What is meant on the photos."""

    thing: str = Field("", description="in words, such as 'the left cup'")
    points: list[str] = Field([], description=f"`X,Y` on the thing, {PLACE}")
    not_points: list[str] = Field([], description=f"`X,Y` beside the thing, {PLACE}")
    boxes: list[str] = Field([], description=f"`X,Y,WIDTH,HEIGHT` around it, {PLACE}")

    def flags(self) -> list[str]:
        flags = [f"--thing={self.thing}"] if self.thing else []
        flags += [f"--point={place}" for place in self.points]
        flags += [f"--not-point={place}" for place in self.not_points]
        return flags + [f"--box={place}" for place in self.boxes]


class Tools:
    """What an assistant can do in `folder`; `config` lies under every edit, and a command that
    takes longer than `limit` [s] is ended.
    """

    def __init__(self, folder: Path, config: str | None, limit: float) -> None:
        self.folder = folder
        self.config = config
        self.limit = limit
        self._one_at_a_time = anyio.Lock()

    async def select(
        self, photos: list[str], marks: MarkArguments, context: Context
    ) -> list:
        """Show what is selected on every photo: all that is not selected is dark. Nothing is
        edited.
        """
        words = ("mask", *self._photos(photos), *marks.flags())
        async with self._turn(context):
            out = self._unused("selection")
            said = await self._command(context, *words, f"--out={out}")
        return [said, _sent(out / "preview.png")]

    async def edit(
        self,
        prompt: str,
        context: Context,
        photos: list[str] | None = None,
        marks: MarkArguments | None = None,
        earlier: str = "",
        guess: bool = False,
        measure: str = "",
        up: str = "",
    ) -> list:
        """Edit photos of one scene as a sentence says ("paint the bike red"), and make it 3D.

        Give two or more photos, or one splat file, or as `earlier` the name of a run that is edited
        again. What changes is the thing that the sentence names, or the marks. It takes some
        seconds a photo. Words that hardly tell which thing is meant are asked about; `guess` takes
        the likeliest. `measure` is a length that the user knows between two places, such as
        `1:120,80,1:400,80=1.2m`: the scene is then in metres. `up` are three places on a floor or a
        table, such as `1:120,380,1:400,350,1:300,420`: the scene then stands upright.
        """
        given = [f"--from={self._found(earlier)}"] if earlier else []
        given += self._photos(photos or [])
        if not given:
            raise ToolError("Give photos, or the name of an earlier run.")
        given += marks.flags() if marks else []
        given += [f"--config={self.config}"] if self.config else []
        given += ["--guess"] if guess else []
        given += [f"--measure={measure}"] if measure else []
        given += [f"--up={up}"] if up else []
        words = ("run", *given, f"--prompt={prompt}", "--progress=json")
        async with self._turn(context):
            out = self._unused("edit")
            await self._command(context, *words, f"--out={out}")
        return self.look(out.name)

    def look(self, run: str) -> list:
        """Show the photos, the 2D edits and the 3D scene of a run, with the verdicts."""
        folder = self._found(run)
        lines = [f"run: {run} (walk through it in {folder / 'viewer.html'})"]
        try:
            about = read_json(folder / "run.json")
            for what, key in ANSWERS:
                verdict = about.get(key)
                if verdict:
                    lines.append(f"{what}: {verdict['label']}, {verdict['reason']}")
            return ["\n".join(lines), _sent(folder / "before_after.png")]
        except Exception as error:  # the folder may come from a stranger
            raise ToolError(f"{folder}: is damaged and not shown ({error}).") from None

    async def export(self, run: str, form: str, context: Context) -> str:
        """Write the scene of a run for other programs.

        The forms, each with what is kept and lost:
        """
        folder = self._found(run)
        writer = _writers().get(form)
        if writer is None:
            raise ToolError(
                f"{form[:60]!r}: no form; there are {', '.join(_writers())}."
            )
        words = ("export", str(folder), f"--to={form}")
        async with self._turn(context):
            out = self.folder / writer.file_name(run)
            if os.path.lexists(out):
                out = self._unused(run, out.name.removeprefix(run))
            return await self._command(context, *words, f"--out={out}")

    def _photos(self, photos: list[str]) -> list[str]:
        return [str(self.folder / photo) for photo in photos]

    def _found(self, run: str) -> Path:
        """The folder of a run, which lies in the server's folder and nowhere else."""
        runs = sorted(file.parent.name for file in self.folder.glob("*/run.json"))
        if run not in runs:
            raise ToolError(
                f"{run[:200]!r} is no run; there are: {', '.join(runs) or 'none'}."
            )
        return self.folder / run

    def _unused(self, stem: str, end: str = "") -> Path:
        """The first of `stem-1`, `stem-2`, ... where nothing lies yet, not even a link."""
        paths = (self.folder / f"{stem}-{number}{end}" for number in count(1))
        return next(path for path in paths if not os.path.lexists(path))

    @asynccontextmanager
    async def _turn(self, context: Context) -> AsyncIterator[None]:
        """One at a time: commands take all cores, and names that are free are taken in turn."""
        waiting = "waits until the call before it has ended"
        await _told(self._one_at_a_time.acquire, context, lambda: waiting)
        try:
            yield
        finally:
            self._one_at_a_time.release()

    async def _command(self, context: Context, *words: str) -> str:
        """What a command of edit3r prints. Raises ToolError with its own sentence."""
        command = [*PYTHON, "-m", "edit3r", *words]
        with TemporaryDirectory() as room:
            out, error = Path(room, "out"), Path(room, "error")
            try:
                with anyio.fail_after(self.limit):
                    code = await ended(command, out, error, context)
            except TimeoutError:
                raise ToolError(
                    f"Not done within {self.limit:g} s, so it was ended; give fewer photos, or "
                    "start the server with a longer --limit."
                ) from None
            except (OSError, ValueError) as fault:  # a null byte, too long, no Unicode
                raise ToolError(f"cannot be passed on ({fault}).") from None
            if code:
                raise ToolError(_last_line(error) or f"edit3r ended: {code}.")
            return out.read_text("utf-8", "replace").strip()


async def ended(command: list[str], out: Path, error: Path, context: Context) -> int:
    """The exit code of a program whose outputs go to two files; what it says last is told."""
    with out.open("wb") as said, error.open("wb") as wrong:
        process = await anyio.open_process(
            command, stdin=DEVNULL, stdout=said, stderr=wrong
        )
    async with process:  # killed where the call is cancelled
        return await _told(process.wait, context, lambda: _doing(_last_line(error)))


async def _told(
    step: Callable[[], Awaitable[Answer]], context: Context, said: Callable[[], str]
) -> Answer:
    """What `step` gives; until then, the assistant is told every few seconds that it goes on."""
    begun = time.monotonic()
    while True:
        with anyio.move_on_after(TOLD_EVERY):
            return await step()
        await context.report_progress(time.monotonic() - begun, message=said())


def _last_line(file: Path) -> str:
    lines = file.read_text("utf-8", "replace").strip().splitlines()
    return lines[-1] if lines else ""


def _doing(line: str) -> str:
    """What a run says in one line of `--progress json`; any other line is told as it is."""
    try:
        event = json.loads(line)
        counted = f": {event['done']} of {event['total']}" if event["total"] else ""
        return f"{event['text']}{counted}"
    except (ValueError, TypeError, KeyError):
        return line or "begins"


def server(folder: Path, config: str | None, limit: float) -> MCPServer:
    """The server whose tools write to `folder` only, in at most `limit` seconds a call."""
    tools = Tools(folder, config, limit)
    told = f"{INSTRUCTIONS} A call that takes longer than {limit:g} seconds is ended."
    made = MCPServer("edit3r", instructions=told)
    for tool in (tools.select, tools.edit, tools.look):
        made.tool(structured_output=False)(tool)
    told = inspect.getdoc(tools.export) or ""
    forms = [
        f"{name}: {one.summary}; keeps {one.keeps}, loses {one.loses}"
        for name, one in _writers().items()
    ]
    export = made.tool(structured_output=False, description="\n".join([told, *forms]))
    export(tools.export)
    return made


def _writers() -> dict[str, Component]:
    offers = default_registry().offers("writer")
    return {offer.component.name: offer.component for offer in offers}


def _sent(path: Path) -> Image:
    """An image in the size and form in which assistants take it."""
    content = io.BytesIO()
    image = read_image(path, MAX_SIDE)
    image.thumbnail((MAX_SIDE, MAX_SIDE))
    image.save(content, "JPEG", quality=90)
    return Image(data=content.getvalue(), format="jpeg")
