"""What is to change: the sentence, and marks on the photos."""

import zlib
from collections.abc import Callable
from functools import partial
from typing import Any
from urllib.parse import quote

from nicegui import run, ui
from pydantic import ValidationError

from edit3r.contract.errors import Edit3rError, InputError
from edit3r.running import MAX_GROWTH
from edit3r_app import uploads
from edit3r_app.draft import MARK, Draft, Mark, Step, read_draft
from edit3r_app.forms import run_settings
from edit3r_app.jobs import AppJob
from edit3r_app.looking import DraftAnswer
from edit3r_app.pages.parts import (
    Event,
    Tab,
    address,
    card,
    html,
    img,
    quiet,
    verdict,
)
from edit3r_app.pages.settings import SettingsForm
from edit3r_app.pages.start import chooser_of_files, told_of_uploads

MODES = ["add", "remove", "box", "paint", "erase"]
SAY = "say what to change, such as: paint it golden."
SEND = "(event) => event.isComposing || emit(event.target.value)"
"""What the field holds at this moment: the server's copy waits until nothing is typed."""
READINGS = {"larger": 1, "smaller": -1}
"""Steps to another reading of what is selected."""


class Editing:
    def __init__(self, tab: Tab) -> None:
        self.tab = tab
        self.answered: Draft | None = None
        self.images: dict[str, ui.element] = {}

    def build(self) -> None:
        with card("Edit it again" if self.tab.is_run else "Say what to change"):
            self._sentence()
            self._tools()
            self.named()
            self.told = ui.column()
            self._photos()
            SettingsForm(self.tab).build()
        ui.on("edit3r_mark", self._mark)
        ui.on("edit3r_undo", self._undo)
        ui.on("edit3r_step", lambda event: self._step(event.args))

    async def follow(self) -> None:
        """Answer what this tab or another changed."""
        if self.tab.draft != self.answered:
            await self._answer()

    # ---- the sentence ----

    def _sentence(self) -> None:
        with ui.row().classes("items-center w-full no-wrap"):
            said = ui.input(placeholder="paint it golden").classes("grow")
            said.value = self.tab.draft.form.get("prompt", "")
            said.props("debounce=300 aria-label='what to change' maxlength=2000")
            said.on_value_change(lambda event: self._say(event.value))
            said.on(
                "keydown.enter", lambda event: self._go(event.args), js_handler=SEND
            )
            self.go = ui.button("Go", on_click=lambda: self._go(said.value))
        self.understood = quiet("")
        self.judged = ui.column()

    async def _say(self, sentence: str) -> None:
        await self._change(lambda draft: draft.form.update(prompt=sentence))

    async def _go(self, sentence: str) -> None:
        """Put the edit into the queue, and go to its page."""
        self.go.disable()
        try:
            self.tab.edit(lambda draft: draft.form.update(prompt=sentence))
            job = await run.io_bound(self._queued)
        except Edit3rError as error:
            self._tell(str(error))
        else:
            ui.navigate.to(address(job.scene, job.name))
        finally:
            self.go.enable()

    def _queued(self) -> AppJob:
        tab = self.tab
        look = tab.looker.look(tab.state, tab.draft)
        if look.job is None:
            raise InputError(look.problem or SAY)
        job = AppJob(
            name="",
            scene=tab.scene,
            parent=tab.state if tab.is_run else "",
            settings=run_settings(tab.draft, tab.looker.registry),
            size=tab.looker.size,
        )
        job = tab.folder.new_job(job, () if look.marked is None else look.marked)
        tab.looker.begin_preview(look, job.name)
        return job

    # ---- marks ----

    def _tools(self) -> None:
        quiet("Click the thing to change on any photo, unless the sentence names it.")
        with ui.row().classes("items-center"):
            self.mode = ui.toggle(MODES, value="add", on_change=self._take_up)
            self.brush = ui.slider(min=1, max=12, value=4, on_change=self._take_up)
            self.brush.props("aria-label='brush'").classes("e3-brush")
            ui.button("Undo", on_click=self._undo).props("flat")
            ui.button("Clear", on_click=partial(self._select, [])).props("flat")
        with ui.row().classes("items-center"):
            for name in READINGS:
                ui.button(name, on_click=partial(self._step, name)).props("outline")
            invert = partial(self._take, Step("invert"))
            ui.button("invert", on_click=invert).props("outline")
            self.grow = ui.number(
                "grow by pixels",
                value=self.tab.draft.outline["grow"],
                min=-MAX_GROWTH,
                max=MAX_GROWTH,
                on_change=self._grow,
            )
            self.grow.props("dense outlined debounce=400").classes("e3-grow")

    def _take_up(self) -> None:
        """Mark in another way from now on; the page's script reads it from the grid."""
        props = {"data-mode": self.mode.value, "data-radius": self.brush.value / 100}
        self.grid._props.update(props)
        self.grid.update()

    @ui.refreshable_method
    def named(self) -> None:
        """Selecting by words, and the selections that were kept under a name."""
        with ui.row().classes("items-center"):
            words = ui.input(placeholder="or name it: the sky")
            words.on("keydown.enter", lambda: self._find(words.value))
            ui.button("Find", on_click=lambda: self._find(words.value)).props("outline")
            ui.button("Keep", on_click=lambda: self._keep(words.value)).props("flat")
            kept = read_draft(self.tab.folder, self.tab.scene).named
            for name, marks in kept.items():
                ui.button(name, on_click=partial(self._select, marks)).props("outline")

    def _photos(self) -> None:
        tab = self.tab
        fixed = bool(tab.folder.history(tab.scene))
        with html("div", "e3-photos", data_mode="add") as self.grid:
            for name in tab.names:
                with html("div", "e3-photo"):
                    self.images[name] = img("", name, "e3-mark")
                    ui.label(name).classes("e3-name")
                    if not fixed:
                        away = ui.button(icon="close").classes("e3-away")
                        away.props("round size=xs aria-label='take out'")
                        away.on_click(partial(self._take_out, name))
        if not fixed:
            chooser_of_files("Add photos", tab.scene).props("flat")
            told_of_uploads()

    def _take_out(self, name: str) -> None:
        uploads.remove(self.tab.folder, self.tab.scene, name)
        ui.navigate.reload()

    async def _mark(self, event: Event) -> None:
        """A click or a drag on a photo, as the page's script tells it."""
        try:
            mark = MARK.validate_python(event.args)
        except ValidationError:
            return
        await self._take(mark)

    async def _take(self, mark: Mark | Step) -> None:
        await self._change(lambda draft: draft.take(mark))

    async def _undo(self) -> None:
        await self._change(Draft.take_back)

    async def _step(self, name: str) -> None:
        """Take the next larger or smaller reading; one that shows nothing new is taken back."""
        if name not in READINGS:
            return
        tab = self.tab
        before = tab.draft
        await self._take(Step("larger", READINGS[name]))
        after = tab.draft
        if await run.io_bound(tab.looker.changes, tab.state, before, after):
            return
        if after == tab.draft:  # meanwhile nothing else was said
            await self._undo()
        raise InputError(f"there is no {name} reading of what is selected.")

    async def _grow(self, event: Event) -> None:
        pixels = min(max(event.value or 0.0, -MAX_GROWTH), MAX_GROWTH)
        if pixels != self.tab.draft.outline["grow"]:
            await self._take(Step("grow", pixels))

    async def _find(self, words: str) -> None:
        if not words:
            raise InputError("say which thing to look for, such as: the sky.")
        await self._select([], words)

    async def _select(self, marks: list, words: str = "") -> None:
        """Replace what is marked."""
        new = {"marks": marks, "words": words, "guess": False}
        await self._change(lambda draft: vars(draft).update(new))

    async def _guess(self) -> None:
        await self._change(lambda draft: vars(draft).update(guess=True))

    def _keep(self, name: str) -> None:
        marks = self.tab.draft.marks
        if not name or not marks:
            raise InputError("mark something, and type the name to keep it under.")
        self.tab.edit(lambda draft: draft.named.update({name: marks}), self.tab.scene)
        self.named.refresh()

    async def _change(self, change: Callable[[Draft], Any]) -> None:
        self.tab.edit(change)
        await self._answer()

    # ---- what it means ----

    async def _answer(self) -> None:
        """Show what is selected, and say how the sentence is read."""
        tab = self.tab
        self.answered = draft = tab.draft
        self.grow.value = draft.outline["grow"]
        self.grid._props["data-marks"] = draft.as_json()
        self.grid.update()
        version = zlib.crc32(draft.as_json().encode())
        for name, image in self.images.items():
            there = f"/marked/{quote(tab.state)}/{quote(name)}?{version}"
            image._props["src"] = there
            image.update()
        look = await run.io_bound(tab.looker.look, tab.state, draft)
        if draft == self.answered:  # meanwhile nothing else was said
            told = f"understood: {look.understood}" if look.understood else ""
            self.understood.set_text(told)
            self._tell(look.problem, look.told, look.asks and not draft.guess)
            await self._judge(look, draft)

    async def _judge(self, look: DraftAnswer, draft: Draft) -> None:
        """Say how sure the words are and, of a quick editor, what its 2D edit is worth."""
        judged = await run.io_bound(self.tab.looker.edit_verdict, look)
        if draft != self.answered:
            return
        self.judged.clear()
        with self.judged:
            if look.surety is not None:
                quiet(f"found by its name, {look.surety:.0%} sure")
            if judged is not None:
                verdict(f"edit: {judged.label}", judged.reason)

    def _tell(self, problem: str, told: tuple = (), asks: bool = False) -> None:
        self.told.clear()
        with self.told:
            quiet(problem, warning=True)
            if asks:
                ui.button("Take what stands out most", on_click=self._guess)
            for sentence in told:
                quiet(sentence)
