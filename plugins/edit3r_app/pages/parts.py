"""What several pages are made of."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from nicegui import ui

from edit3r.contract.errors import Edit3rError
from edit3r_app.draft import Draft, read_draft, write_draft
from edit3r_app.jobs import PREVIEW, AppJob, JobsFolder, manifest_of
from edit3r_app.looking import Looker
from edit3r_app.runner import Runner

COLOURS = {
    "good": "positive",
    "fair": "primary",
    "poor": "warning",
    "doubtful": "warning",
    "failed": "negative",
}
"""Of verdicts, in the page library's words."""
HEAD = (
    '<link rel="stylesheet" href="/static/app.css"><script src="/static/app.js" defer>'
    "</script>"
)

Event = Any  # of the page library


@dataclass(frozen=True)
class Tab:
    """One tab of a browser: a scene at one state, which is its photos or one of its jobs."""

    folder: JobsFolder
    runner: Runner
    looker: Looker
    scene: str = ""
    state: str = ""

    @property
    def job(self) -> AppJob:
        return self.folder.job(self.state)

    @property
    def is_run(self) -> bool:
        return self.folder.is_run(self.state)

    @property
    def names(self) -> list[str]:
        """Of the photos."""
        return list(self.folder.photos(self.state))

    @property
    def draft(self) -> Draft:
        return read_draft(self.folder, self.state)

    def edit(self, change: Callable[[Draft], Any], state: str = "") -> None:
        """Change a draft, the state's own or another."""
        draft = read_draft(self.folder, state or self.state)
        change(draft)
        write_draft(self.folder, state or self.state, draft)


@contextmanager
def frame(scene: str = "") -> Iterator[None]:
    """What every page has: styles, our script, the line at the top, and a place for errors."""
    ui.add_head_html(HEAD)
    ui.colors(primary="#5b4be1")
    ui.on_exception(_tell)
    with ui.header().classes("items-center"):
        ui.link("edit3r", "/").classes("e3-home")
        if scene:
            ui.link(scene, address(scene)).classes("ellipsis")
    try:
        yield
    except Edit3rError as error:
        quiet(str(error), warning=True)


def _tell(error: Exception) -> None:
    """Say why what the user asked for was not done."""
    text = in_app(str(error) or repr(error))
    ui.notify(text, type="negative", multi_line=True, timeout=0, close_button="close")


def in_app(sentence: str) -> str:
    """A sentence of edit3r without the flags of the command line."""
    return re.sub(r" \(--[^)]*\)", "", sentence)


def html(tag: str, classes: str = "", **props: Any) -> ui.element:
    """An element; in names of properties "_" stands for "-"."""
    element = ui.element(tag).classes(classes)
    element._props.update({key.replace("_", "-"): props[key] for key in props})
    return element


def img(source: str, text: str, classes: str = "") -> ui.element:
    return html("img", classes, src=source, alt=text, draggable="false")


def card(title: str) -> ui.element:
    """A white field under a title, to be filled in a `with`."""
    field = html("div", "e3-card")
    with field:
        ui.label(title).classes("e3-title")
    return field


def quiet(text: str, warning: bool = False) -> ui.label:
    return ui.label(in_app(text)).classes("e3-warning" if warning else "e3-quiet")


def verdict(label: str, reason: str) -> None:
    with ui.row().classes("items-center no-wrap"):
        badge(label)
        ui.label(reason)


def badge(label: str) -> None:
    ui.badge(label, color=COLOURS.get(label.rpartition(" ")[2], "grey"))


def judgements(tab: Tab, run: str) -> Iterator[tuple[str, str]]:
    """Label and reason of a run's verdicts on its scene and on its edit; of one that is not
    finished the verdict on its preview.
    """
    folder = tab.folder
    manifest = manifest_of(folder.root / run) or manifest_of(
        folder.private / run / PREVIEW
    )
    for on, key in (("scene", "verdict"), ("edit", "edit_verdict")):
        verdict = manifest.get(key)
        if isinstance(verdict, dict):
            label = f"{on}: {verdict.get('label')}"
            yield label[:40], str(verdict.get("reason", ""))[:1000]


def viewer(run: str) -> None:
    """The scene of a run in 3D; its page may come from a stranger."""
    html(
        "iframe",
        "e3-viewer",
        src=f"/viewer/{quote(run)}",
        sandbox="allow-scripts allow-downloads",
        title="the scene in 3D",
    )


def address(scene: str, at: str = "") -> str:
    """The page of a scene, at one of its runs."""
    there = f"?at={quote(at)}" if at not in ("", scene) else ""
    return f"/s/{quote(scene)}{there}"
