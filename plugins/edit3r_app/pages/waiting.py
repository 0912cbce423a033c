"""An edit that is being made, waits, or failed: its stages, and the 2D edit at once."""

from pathlib import Path
from urllib.parse import quote

from nicegui import run, ui

from edit3r_app.jobs import PREVIEW
from edit3r_app.pages.parts import (
    Tab,
    address,
    card,
    html,
    img,
    judgements,
    quiet,
    verdict,
)
from edit3r_app.progress import read_progress, time_left


class Waiting:
    def __init__(self, tab: Tab) -> None:
        self.tab = tab
        self.shown: dict[str, Path] = {}

    def build(self) -> None:
        with html("div", "e3-result"):
            with card(self.tab.job.prompt):
                self.stages()
            with card("What changes in the photos"):
                self.preview()

    async def follow(self) -> None:
        self.stages.refresh()
        if self._images() != self.shown:
            self.preview.refresh()

    def _images(self) -> dict[str, Path]:
        return self.tab.folder.images(self.tab.state, PREVIEW)

    @ui.refreshable_method
    def stages(self) -> None:
        job = self.tab.job
        if job.state == "queued":
            quiet("waiting for the edit before it")
            quiet(self.tab.runner.trouble, warning=True)
        elif job.state == "running":
            self._running()
        if job.is_active:
            ui.button("Cancel", on_click=self._cancel).props("flat")
        else:
            quiet(f"{job.state}: {job.sentence}", warning=True)
            ui.link("Go back and change it", address(job.scene, job.parent))

    async def _cancel(self) -> None:
        await run.io_bound(self.tab.runner.cancel, self.tab.state)

    def _running(self) -> None:
        progress = read_progress(self.tab.folder.log(self.tab.state))
        left = time_left(self.tab.folder, self.tab.job, progress)
        for stage, seconds in progress.done.items():
            quiet(f"✓ {stage}: {seconds:.1f} s")
        told = f"; about {left + 1:.0f} s left" if left is not None else ""
        ui.label((progress.stage or "starting") + told)
        bar = ui.linear_progress(progress.share or 0, show_value=False)
        if progress.share is None:
            bar.props("indeterminate")
        for sentence in progress.told:
            quiet(sentence)

    @ui.refreshable_method
    def preview(self) -> None:
        self.shown = self._images()
        for label, reason in judgements(self.tab, self.tab.state):
            verdict(label, reason)
        with html("div", "e3-photos"):
            for name in self.shown:
                with html("div", "e3-photo"):
                    source = f"/image/{quote(self.tab.state)}/{PREVIEW}/{quote(name)}"
                    img(source, name, "e3-preview")
                    ui.label(name).classes("e3-name")
