"""The pages: where photos are dropped, and where one scene is marked, edited, judged and edited
again.
"""

import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import run, ui

from edit3r.errors import Edit3rError, InputError
from edit3r.io.images import packaged_pair
from edit3r.pipeline.config import DEFAULTS, RunConfig
from edit3r.pipeline.quality import PRESETS
from edit3r.plugins.registry import default_registry
from edit3r_app import forms, uploads
from edit3r_app.choosing import Chooser, Draft, Stroke, read_draft, write_draft
from edit3r_app.jobs import Job, JobsFolder, redo, tree, undo
from edit3r_app.runner import Runner, read_progress, time_left

COLOURS = {
    "good": "positive",
    "fair": "primary",
    "poor": "warning",
    "failed": "negative",
}
DOWNLOADS = {
    "scene.ply": "the scene for other programs (3D Gaussians)",
    "viewer.html": "one page that opens anywhere, to send",
    "video.webm": "a flight around the scene",
    "before_after.png": "photo, edit and 3D side by side",
    "run.json": "how it was made",
    "all.zip": "everything in one file",
}
TYPES = f"JPEG, PNG, HEIC and others; at most {uploads.MOST_PHOTOS} photos of {uploads.MOST_BYTES >> 20} MB."
CUT = "(event) => event.target.parentElement.style.setProperty('--cut', event.target.value + '%')"
Event = Any  # of the page library


def add_pages(folder: JobsFolder, runner: Runner, chooser: Chooser) -> None:
    """Register the two pages."""
    ui.button.default_props("no-caps unelevated")
    ui.toggle.default_props("no-caps dense unelevated padding='4px 12px'")
    ui.input.default_props("dense")
    ui.select.default_props("dense")
    ui.expansion.default_classes("w-full")

    @ui.page("/")
    def home() -> None:
        _frame("")
        _start(folder)

    @ui.page("/s/{scene}")
    def one_scene(scene: str, at: str = "") -> None:
        _frame(scene)
        try:
            ScenePage(folder, runner, chooser, scene, at).build()
        except Edit3rError as error:
            ui.label(str(error))
            ui.link("All scenes", "/")


def _frame(title: str) -> None:
    """What every page has: styles, our script, and the line at the top."""
    ui.add_head_html(
        '<link rel="stylesheet" href="/static/app.css"><script src="/static/app.js" defer></script>'
    )
    ui.colors(primary="#5b4be1")
    with ui.header().classes("items-center").style("padding: 8px 20px"):
        ui.link("edit3r", "/").classes("text-white text-lg font-medium no-underline")
        ui.label(title).classes("ellipsis").style("max-width: 60vw")
    ui.on(
        "edit3r_sending",
        lambda e: ui.notify(
            f"sending {e.args['done'] + 1} of {e.args['total']}", timeout=700
        ),
    )


def _card(title: str = "") -> ui.element:
    """A white field, to be filled in a `with`."""
    card = ui.element("div").classes("e3-card")
    if title:
        with card:
            ui.label(title).classes("e3-title")
    return card


def _quiet(text: str, warning: bool = False) -> None:
    ui.label(text).classes("text-negative" if warning else "e3-quiet")


def _img(source: str, text: str) -> ui.element:
    image = ui.element("img")
    image._props.update({"src": source, "alt": text, "draggable": "false"})
    return image


def _address(scene: str, at: str = "") -> str:
    return f"/s/{quote(scene)}" + (f"?at={quote(at)}" if at and at != scene else "")


def _chooser_of_files(label: str, scene: str, folder: str = "false") -> ui.button:
    open_it = f"() => edit3rChoose(decodeURIComponent({quote(scene)!r}), {folder})"
    return ui.button(label).on("click", js_handler=open_it)


def _drop_zone(scene: str, text: str) -> None:
    """Where photos are dropped or chosen; they go to `scene`, or "" to a new one."""
    zone = ui.column().classes("e3-drop")
    zone._props["data-scene"] = scene
    with zone:
        ui.label(text).classes("text-lg")
        with ui.row().classes("justify-center"):
            _chooser_of_files("Choose photos", scene)
            _chooser_of_files("Choose a folder", scene, "true").props("outline")
        _quiet(TYPES)
    _told_of_uploads()


def _told_of_uploads() -> None:
    """Go to the scene when everything was taken; else say what was refused and why."""
    refused = ui.column()

    def sent(event: Event) -> None:
        sentences = [str(sentence)[:500] for sentence in event.args.get("refused", [])]
        scene = str(event.args.get("scene") or "")
        if scene and not sentences:
            ui.navigate.to(_address(scene))
            return
        refused.clear()
        with refused:
            for sentence in [
                *sentences[:10],
                *([f"and {len(sentences) - 10} more"] if len(sentences) > 10 else []),
            ]:
                _quiet(sentence, warning=True)
            if scene:
                ui.link("Go on with the photos that were taken", _address(scene))

    ui.on("edit3r_sent", sent)


def _start(folder: JobsFolder) -> None:
    """The first page."""
    _drop_zone("", "Drop two or more photos of one scene here, or a folder of them")

    def example() -> None:
        ui.navigate.to(
            _address(
                uploads.copied(
                    folder, "motorcycle", [Path(file) for file in packaged_pair()[0]]
                )
            )
        )

    ui.button("Or try it with two photos of a motorcycle", on_click=example).props(
        "flat"
    )
    scenes = folder.scenes()
    if scenes:
        ui.label("Your scenes").classes("e3-title")
    with ui.element("div").classes("e3-thumbs"):
        for scene in scenes[:200]:
            with ui.link(target=_address(scene.name)).classes(
                "no-underline text-black"
            ):
                with ui.element("div").classes("e3-photo e3-cover"):
                    if scene.photos:
                        _img(f"/thumbnail/{quote(scene.name)}/0", scene.name)
                ui.label(scene.name).classes("ellipsis")
                _quiet(f"{scene.photos} photos, {scene.edits} edits")


class ScenePage:
    """One scene in one tab, in one state: its photos, or a run that was made from them."""

    def __init__(
        self, folder: JobsFolder, runner: Runner, chooser: Chooser, scene: str, at: str
    ) -> None:
        folder.path(scene)
        if at and folder.job(at).scene != scene:
            raise InputError(f"{at}: not an edit of {scene}.")
        self.folder, self.runner, self.chooser, self.scene, self.state = (
            folder,
            runner,
            chooser,
            scene,
            at or scene,
        )
        self.names = [path.stem for path in folder.photos(self.state)]
        self.is_run = folder.is_run(self.state)
        self.at = self.state if self.is_run else ""  # as the parent of a job
        self.mode, self.after, self.following = "add", "renders", ""
        self.registry = default_registry()
        self.pictures: list[ui.element] = []
        self.version, self.seen = 0, self._signature()

    def build(self) -> None:
        with ui.element("div").classes("e3-columns"):
            with ui.column().classes("w-full"):
                if self.is_run:
                    self._result()
                if len(self.names) > 1:
                    self._choose()
                    self._wish()
                    self.progress()
                else:
                    _drop_zone(
                        self.scene, "One more photo at least, taken from another place"
                    )
            with ui.column().classes("w-full"):
                self.history()
                if not self.is_run:
                    self._photos()
        if len(self.names) > 1:
            ui.on("edit3r_mark", self._mark)
            self.chooser.prepare(self.state)
        ui.timer(0.7, self._tick)

    # ---- the state of the folder, looked at again and again: another tab may change it ----

    def _signature(self) -> tuple:
        return tuple((job.name, job.state) for job in self.folder.history(self.scene))

    def _tick(self) -> None:
        signature, before = self._signature(), self.seen
        self.seen = signature
        if (self.following, "done") in signature:
            ui.navigate.to(_address(self.scene, self.following))
            self.following = ""  # once: asking again would break off the loading
        elif signature != before:
            self.history.refresh()
        if signature != before or any(
            state in ("running", "queued") for _, state in signature
        ):
            self.progress.refresh()
        if self.pictures and self._version() != self.version:
            self._show_masks()

    @ui.refreshable_method
    def progress(self) -> None:
        """What is running and waiting, and what went wrong last."""
        jobs = list(self.folder.jobs())
        if self.following and (job := self.folder.job(self.following)).state in (
            "failed",
            "cancelled",
        ):
            with _card():
                _quiet(f"“{job.prompt}”: {job.sentence}", warning=True)
        active = [
            job for state in ("running", "queued") for job in jobs if job.state == state
        ]
        for place, job in enumerate(active):
            with _card(f"“{job.prompt}” ({job.scene})"):
                if job.state == "queued":
                    _quiet(f"waiting, {place} before it")
                else:
                    self._stages(job)
                ui.button(
                    "Cancel",
                    on_click=partial(run.io_bound, self.runner.cancel, job.name),
                ).props("flat dense")

    def _stages(self, job: Job) -> None:
        found = read_progress(self.folder.log(job.name))
        left = time_left(self.folder, job, found, time.time())
        for name, seconds in found.done:
            _quiet(f"✓ {name}: {seconds:.1f} s")
        share = f", {found.share:.0%}" if found.share is not None else ""
        ui.label(
            f"{found.stage or 'starting'}{share}"
            + ("" if left is None else f"; about {left + 1:.0f} s left")
        )
        bar = ui.linear_progress(found.share or 0.0, show_value=False)
        if found.share is None:
            bar.props("indeterminate")

    @ui.refreshable_method
    def history(self) -> None:
        """Every edit of the scene as a tree; undo and redo are steps in it."""
        jobs = self.folder.history(self.scene)
        with _card("History"), ui.column().classes("gap-1"):
            with ui.row():
                for label, target in (
                    ("Undo", undo(jobs, self.state)),
                    ("Redo", redo(jobs, self.at)),
                ):
                    button = ui.button(
                        label,
                        icon=label.lower(),
                        on_click=partial(self._go_to, target or ""),
                    )
                    button.props("outline dense padding='4px 10px'").set_enabled(
                        target is not None
                    )
            if not self.folder.is_run(self.scene):
                self._node("photos as they are", "", 0, "")
            for depth, job in tree(jobs):
                label = job.label if job.state == "done" else job.state
                self._node(job.prompt or "no wish", job.name, depth + 1, label)
                if job.state == "failed":
                    _quiet(job.sentence, warning=True)

    def _node(self, text: str, name: str, depth: int, label: str) -> None:
        with ui.button(on_click=partial(self._go_to, name)).props(
            "dense align=left"
        ) as button:
            ui.label(text).classes("ellipsis")
            if label:
                ui.badge(label, color=COLOURS.get(label, "grey"))
        button.classes("e3-node").style(f"margin-left: {min(depth, 8) * 12}px")
        button.props("" if name == self.at else "flat").set_enabled(
            not name or self.folder.is_run(name)
        )

    def _go_to(self, name: str) -> None:
        ui.navigate.to(_address(self.scene, name))

    def _photos(self) -> None:
        """The photos of a set, and more of them, as long as nothing was made from them."""
        fixed = bool(self.folder.history(self.scene))
        with _card(f"{len(self.names)} photos"):
            with ui.element("div").classes("e3-thumbs"):
                for view, name in enumerate(self.names):
                    with ui.element("div").classes("e3-photo"):
                        _img(f"/thumbnail/{quote(self.scene)}/{view}", name)
                        if not fixed:
                            away = ui.button(
                                icon="close", on_click=partial(self._take_out, view)
                            ).classes("e3-away")
                            away.props(
                                "round dense size=xs color=dark aria-label='take out'"
                            )
            if not fixed and len(self.names) > 1:
                _chooser_of_files("Add photos", self.scene).props("flat dense")
                _told_of_uploads()

    def _take_out(self, view: int) -> None:
        uploads.remove(self.folder, self.scene, view)
        self._edit_draft(Draft.clear_marks)
        ui.navigate.reload()

    # ---- choosing the object ----

    def _choose(self) -> None:
        with _card("Click the thing to change"):
            _quiet(
                "One click on one photo; its mask shows on all. Without a mark the wish itself "
                "says where."
            )
            with ui.row().classes("items-center w-full"):
                modes = {
                    "add": "Add",
                    "remove": "Remove",
                    "box": "Box",
                    "paint": "Paint",
                    "erase": "Erase",
                }
                ui.toggle(
                    modes,
                    value="add",
                    on_change=lambda event: self._set_mode(event.value),
                )
                self.brush = ui.slider(
                    min=1, max=12, value=4, on_change=lambda: self._set_mode(self.mode)
                )
                self.brush.props("aria-label='size of the brush'").style(
                    "width: 110px"
                ).set_visibility(False)
                words = ui.input(
                    placeholder="or in words: the sky", value=self._draft().words
                ).props("outlined")
                words.on("keydown.enter", lambda: self._find(words.value or ""))
                ui.button("Find", on_click=lambda: self._find(words.value or "")).props(
                    "outline"
                )
                ui.button(
                    "Clear", on_click=lambda: self._change(Draft.clear_marks)
                ).props("flat")
                self.busy = ui.spinner(size="sm")
            self.told = ui.column().classes("gap-1")
            self.grid = ui.element("div").classes("e3-photos")
            with self.grid:
                for view, name in enumerate(self.names):
                    with ui.element("div").classes("e3-photo"):
                        image = _img("", name).classes("e3-mark")
                        image._props["data-view"] = str(view)
                        self.pictures.append(image)
                        ui.label(name).classes("e3-name")
        self._show_masks()
        ui.timer(0.1, self._answer, once=True)

    def _draft(self) -> Draft:
        return read_draft(self.folder, self.state)

    def _edit_draft(self, change: Callable[[Draft], Any]) -> None:
        draft = self._draft()
        change(draft)
        write_draft(self.folder, self.state, draft)

    def _version(self) -> int:
        return zlib.crc32(repr((self._draft().marks, self.names)).encode())

    def _show_masks(self) -> None:
        self.version = self._version()
        for view, image in enumerate(self.pictures):
            image._props["src"] = f"/photo/{quote(self.state)}/{view}?v={self.version}"
            image.update()

    def _set_mode(self, mode: str) -> None:
        brushing = mode in ("paint", "erase")
        self.mode = mode
        self.brush.set_visibility(brushing)
        self.grid.classes(
            replace="e3-photos" + " e3-box" * (mode == "box") + " e3-brush" * brushing
        )
        self.grid._props["data-brush"] = str(2 * self.brush.value / 100)
        self.grid.update()

    async def _mark(self, event: Event) -> None:
        """A click or a drag on a photo, as the page's script tells it."""
        try:
            view, box = int(event.args["view"]), bool(event.args["box"])
            places = [
                tuple(min(max(float(n), 0.0), 1.0) for n in place)
                for place in event.args["places"]
            ]
            (x, y), (u, v) = places[0], places[-1]
        except (IndexError, KeyError, TypeError, ValueError):
            return
        remove = self.mode == "remove" or bool(event.args.get("remove"))

        def mark(draft: Draft) -> None:
            if self.mode in ("paint", "erase"):
                draft.strokes.append(
                    Stroke(view, self.mode == "paint", self.brush.value / 100, places)
                )
            elif box:
                draft.boxes[view] = (min(x, u), min(y, v), abs(u - x), abs(v - y))
            else:
                (draft.negative if remove else draft.positive).append((view, x, y))

        if 0 <= view < len(self.names):
            await self._change(mark)

    async def _find(self, words: str, guess: bool = False) -> None:
        await self._change(
            lambda draft: vars(draft).update(words=words.strip()[:200], guess=guess)
        )

    async def _change(self, change: Callable[[Draft], Any]) -> None:
        try:
            self._edit_draft(change)
        except InputError as error:
            ui.notify(str(error), type="negative")
        await self._answer()
        self._show_masks()

    async def _answer(self) -> None:
        """Find the masks, and say what could not be found or ask back."""
        draft, error, warnings = self._draft(), "", ()
        self.busy.set_visibility(True)
        try:
            found = await run.io_bound(self.chooser.masks, self.state, draft)
            warnings = () if found is None else found.warnings
        except Edit3rError as raised:
            error = str(raised)
        self.busy.set_visibility(False)
        self.told.clear()
        with self.told:
            if error and draft.words and not draft.positive and not draft.boxes:
                _quiet(
                    f"“{draft.words}” is not known here. Click on it in a photo, or draw a box "
                    "around it.",
                    True,
                )
                guess = partial(self._find, draft.words, True)
                ui.button("Take what stands out most", on_click=guess).props(
                    "flat dense"
                )
            elif error:
                _quiet(error, warning=True)
            for warning in warnings:
                _quiet(warning)

    # ---- the wish ----

    def _wish(self) -> None:
        form = self._draft().form
        with _card("Say what to change"):
            with ui.row().classes("items-center w-full no-wrap"):
                wish = ui.input(
                    placeholder="paint it golden", value=form.get("prompt", "")
                ).classes("grow")
                wish.props(
                    "outlined debounce=300 aria-label='what to change' maxlength=2000"
                )
                wish.on_value_change(partial(self._typed, "prompt"))
                ui.button("Go", on_click=lambda: self._go(wish.value or "")).props(
                    "padding='8px 26px'"
                )
            with ui.expansion(
                "Editor, reconstructor, quality and their settings"
            ).props("dense"):
                with ui.row().classes("w-full"):
                    unsaid = (
                        "as before"
                        if self.is_run
                        else f"automatic ({DEFAULTS['reconstructor']})"
                    )
                    editors, reconstructors = (
                        forms.offered(self.registry, kind) for kind in forms.CHOSEN
                    )
                    self._select(
                        "editor",
                        list(editors),
                        form.get("editor") or DEFAULTS["editor"],
                    )
                    self._select(
                        "reconstructor",
                        ["", *reconstructors],
                        form.get("reconstructor", ""),
                        unsaid,
                    )
                    self._select(
                        "quality",
                        ["", *PRESETS],
                        form.get("quality", ""),
                        "as the settings say",
                    )
                self.settings()

    def _select(self, key: str, names: list[str], value: str, unsaid: str = "") -> None:
        def chosen(event: Event) -> None:
            self._typed(key, event)
            self.settings.refresh()

        value = value if value in names else names[0]
        options = {name: name or unsaid for name in names}
        ui.select(options, value=value, label=key, on_change=chosen).props(
            "outlined"
        ).style("min-width: 200px")

    def _typed(self, key: str, event: Event) -> None:
        self._edit_draft(lambda draft: draft.form.update({key: event.value}))

    @ui.refreshable_method
    def settings(self) -> None:
        """The settings of what is chosen, from their schemas."""
        form = self._draft().form
        for kind in forms.CHOSEN:
            name = form.get(kind) or (DEFAULTS["editor"] if kind == "editor" else "")
            offers = forms.offered(self.registry, kind)
            if name in offers:
                cls = self.registry.settings_class(self.registry.find(kind, name))
                ui.label(f"{name}: {offers[name]}").classes("font-medium")
                self._fields(f"{kind} {name}", forms.form_fields(cls, self.registry))
        with ui.expansion("Settings of the run").props("dense"):
            self._fields(
                "run", forms.form_fields(RunConfig, self.registry, forms.NOT_IN_FORM)
            )

    def _fields(self, group: str, fields: tuple[forms.FormField, ...]) -> None:
        typed = self._draft().form.get("settings", {}).get(group, {})

        def change(name: str, event: Event) -> None:
            def into(draft: Draft) -> None:
                draft.form.setdefault("settings", {}).setdefault(group, {})[name] = (
                    event.value
                )

            self._edit_draft(into)

        for field in fields:
            value, on_change = (
                typed.get(field.name, field.default),
                partial(change, field.name),
            )
            if field.form == "switch":
                ui.switch(field.name, value=bool(value), on_change=on_change).props(
                    "dense"
                )
            elif field.form == "choice":
                value = value if value in field.choices else field.default
                ui.select(
                    list(field.choices),
                    value=value,
                    label=field.name,
                    on_change=on_change,
                ).classes("w-full")
            else:
                text = ui.input(field.name, value=str(value), on_change=on_change)
                text.props("debounce=400").classes("w-full")
            _quiet(". ".join(text for text in (field.label, field.hint) if text))

    async def _go(self, wish: str) -> None:
        """Put the edit into the queue; its masks are written before it can begin."""
        self._edit_draft(lambda draft: draft.form.update({"prompt": wish}))
        draft = self._draft()
        try:
            settings = forms.run_settings(draft.form, self.registry)
            if not settings["prompt"] and settings["editor"]["name"] != "none":
                raise InputError("say what to change, such as: paint it golden.")
            wished = Job(
                "",
                self.scene,
                self.at,
                settings,
                size=self.chooser.size,
                state="cancelled",
            )
            job = self.folder.new_job(wished)
            masks = await run.io_bound(
                self.chooser.save_masks, self.state, draft, job.name
            )
        except Edit3rError as error:
            ui.notify(str(error), type="negative", multi_line=True, timeout=8000)
            return
        self.runner.submit(job, masks)
        self.following = job.name
        self.progress.refresh()
        self.history.refresh()

    # ---- the result ----

    def _result(self) -> None:
        job = self.folder.job(self.state)
        with _card():
            with ui.row().classes("items-center no-wrap"):
                ui.badge(
                    job.label or "not judged", color=COLOURS.get(job.label, "grey")
                ).classes("text-sm")
                ui.label(job.sentence)
            with ui.row().classes("items-center"):
                ui.label("Before and after").classes("e3-title")
                ui.toggle(
                    {"renders": "in 3D", "edited": "the photos"},
                    value=self.after,
                    on_change=self._set_after,
                )
            self.sliders()
            ui.label("Walk around").classes("e3-title")
            viewer, address = (
                ui.element("iframe").classes("e3-viewer"),
                f"/viewer/{quote(self.state)}",
            )
            allowed = {
                "sandbox": "allow-scripts allow-downloads",
                "title": "the scene in 3D",
            }
            viewer._props.update({"src": address, "loading": "lazy", **allowed})
            ui.label("Take it along").classes("e3-title")
            with ui.row():
                for what, told in DOWNLOADS.items():
                    link = ui.link(
                        what, f"/download/{quote(self.state)}/{what}"
                    ).tooltip(told)
                    link._props["download"] = ""

    def _set_after(self, event: Event) -> None:
        self.after = event.value
        self.sliders.refresh()

    @ui.refreshable_method
    def sliders(self) -> None:
        address = f"/shown/{quote(self.state)}"
        with ui.element("div").classes("e3-photos"):
            for view, name in enumerate(self.names):
                with ui.element("div").classes("e3-photo e3-slider"):
                    _img(f"{address}/{self.after}/{view}", f"{name} after")
                    _img(f"{address}/inputs/{view}", f"{name} before").classes(
                        "e3-before"
                    )
                    ui.label("before").classes("e3-tag").style("left: 8px")
                    ui.label("after").classes("e3-tag").style("right: 8px")
                    handle = ui.element("input").on("input", js_handler=CUT)
                    told = f"before and after: {name}"
                    handle._props.update(
                        {
                            "type": "range",
                            "min": 0,
                            "max": 100,
                            "value": 50,
                            "aria-label": told,
                        }
                    )
