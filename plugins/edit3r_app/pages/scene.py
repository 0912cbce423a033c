"""One scene in one tab: its photos, an edit that is being made, or a finished one."""

from collections.abc import Sequence

from nicegui import ui

from edit3r.contract.errors import InputError
from edit3r_app.jobs import tree
from edit3r_app.pages.editing import Editing
from edit3r_app.pages.parts import Tab, address, badge, card, html, judgements, quiet
from edit3r_app.pages.result import result
from edit3r_app.pages.start import drop_zone
from edit3r_app.pages.waiting import Waiting


class ScenePage:
    def __init__(self, tab: Tab) -> None:
        self.tab = tab
        tab.folder.path(tab.scene)
        if tab.state != tab.scene and tab.job.scene != tab.scene:
            raise InputError(f"{tab.state}: not an edit of {tab.scene}.")
        self.seen: list[tuple[str, str]] = []
        self.main: Waiting | Editing | None = None

    def build(self) -> None:
        with html("div", "e3-columns"):
            with html("div", "e3-main"):
                self._main()
            with html("div", "e3-main"):
                self.history()
        ui.timer(0.7, self._tick)

    def _main(self) -> None:
        tab = self.tab
        if tab.is_run:
            result(tab)
        if not tab.is_run and tab.state != tab.scene:
            self.main = Waiting(tab)
        elif len(tab.names) > 1:
            self.main = Editing(tab)
        else:
            drop_zone(tab.scene, "One more photo at least, taken from another place")
            return
        self.main.build()

    async def _tick(self) -> None:
        """DraftAnswer at the folder again: the queue and other tabs change it."""
        tab = self.tab
        seen = [(job.name, job.state) for job in tab.folder.history(tab.scene)]
        if seen != self.seen:
            self.seen = seen
            self.history.refresh()
        if isinstance(self.main, Waiting) and tab.is_run:
            self.main = None  # once: asking again would break off the loading
            ui.navigate.reload()
        elif self.main is not None:
            await self.main.follow()

    @ui.refreshable_method
    def history(self) -> None:
        """Every edit of the scene, each below the one that it goes on from."""
        tab = self.tab
        with card("History"):
            if not tab.folder.is_run(tab.scene):
                self._node("photos as they are", tab.scene, 0, ())
            for depth, job in tree(tab.folder.history(tab.scene)):
                labels = [label for label, _ in judgements(tab, job.name)]
                labels = labels if job.state == "done" else [job.state]
                self._node(job.prompt or "no edit", job.name, depth + 1, labels)
                quiet(job.sentence, warning=True)

    def _node(self, text: str, name: str, depth: int, labels: Sequence[str]) -> None:
        # A link works before the page is connected; a handler would lose that click.
        with ui.button().classes("e3-node") as button:
            ui.label(text).classes("ellipsis")
            for label in labels:
                badge(label)
        button.props["href"] = address(self.tab.scene, name)
        button.style(f"margin-left: {min(depth, 8) * 12}px")
        if name != self.tab.state:
            button.props("flat")
