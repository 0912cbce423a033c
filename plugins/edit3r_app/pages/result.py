"""A finished edit: the scene in 3D on top, its photos beside, the verdicts, and what can be taken
along.
"""

from functools import partial
from urllib.parse import quote

from nicegui import run, ui

from edit3r.contract.errors import InputError
from edit3r_app.downloads import downloads, prepared
from edit3r_app.pages.parts import (
    Tab,
    card,
    html,
    img,
    judgements,
    verdict,
    viewer,
)

CUT = "(event) => event.target.parentElement.style.setProperty('--cut', event.target.value + '%')"


def result(tab: Tab) -> None:
    with card(tab.job.prompt):
        with html("div", "e3-result"):
            viewer(tab.state)
            with html("div", "e3-beside"):
                _photos(tab)
        verdicts(tab, tab.state)
        _take_along(tab)
        _compare_with(tab)


def compare(tab: Tab, *runs: str) -> None:
    """Two edits of the same photos side by side; their cameras move together."""
    with html("div", "e3-two"):
        for name in runs:
            job = tab.folder.job(name)
            if job.scene != tab.scene:
                raise InputError(f"{name}: not an edit of {tab.scene}.")
            with card(job.prompt):
                viewer(name)
                verdicts(tab, name)


def verdicts(tab: Tab, name: str) -> None:
    for label, reason in judgements(tab, name):
        verdict(label, reason)


def _photos(tab: Tab) -> None:
    """A slider over each photo, between before and after."""
    kinds = {"renders": "in 3D", "edited": "the photos"}
    ui.toggle(kinds, value="renders", on_change=lambda e: sliders.refresh(e.value))

    @ui.refreshable
    def sliders(after: str) -> None:
        for photo in tab.names:
            with html("div", "e3-photo e3-slider"):
                for kind in (after, "inputs"):
                    source = f"/image/{quote(tab.state)}/{kind}/{quote(photo)}"
                    img(source, f"{photo}, {kind}", f"e3-{kind}")
                ui.label("before").classes("e3-tag")
                ui.label("after").classes("e3-tag e3-right")
                told = f"before and after: {photo}"
                handle = html("input", type="range", value=50, aria_label=told)
                handle.on("input", js_handler=CUT)

    with html("div", "e3-photos"):
        sliders("renders")


def _take_along(tab: Tab) -> None:
    async def take(what: str, button: ui.button) -> None:
        button.props("loading")
        try:
            await run.io_bound(prepared, tab.folder, tab.state, what)
        finally:
            button.props(remove="loading")
        ui.download(f"/download/{quote(tab.state)}/{what}")

    ui.label("Take it along").classes("e3-title")
    with ui.row():
        for what, told in downloads().items():
            button = ui.button(what).props("outline").tooltip(told)
            button.on_click(partial(take, what, button))


def _compare_with(tab: Tab) -> None:
    """Choose another edit to see beside this one."""
    others = {
        job.name: job.prompt or job.name
        for job in tab.folder.history(tab.scene)
        if job.state == "done" and job.name != tab.state
    }
    there = f"/compare/{quote(tab.scene)}?one={quote(tab.state)}&other="
    if others:
        chooser = ui.select(others, label="compare with").classes("e3-choice")
        chooser.on_value_change(
            lambda event: ui.navigate.to(there + quote(event.value))
        )
