"""The pages: photos are dropped on the first, and edited and looked at on that of their scene."""

from dataclasses import replace

from nicegui import ui

from edit3r_app.pages.parts import Tab, frame
from edit3r_app.pages.result import compare
from edit3r_app.pages.scene import ScenePage
from edit3r_app.pages.start import start


def add_pages(tab: Tab) -> None:
    """Register the pages; `tab` has the parts of the app, and no scene."""
    ui.button.default_props("no-caps unelevated dense padding='5px 12px'")
    ui.toggle.default_props("no-caps dense unelevated padding='5px 10px'")
    ui.input.default_props("dense outlined")
    ui.select.default_props("dense outlined options-dense")
    ui.expansion.default_classes("w-full")

    @ui.page("/")
    def first_page() -> None:
        with frame():
            start(tab)

    @ui.page("/s/{scene}")
    def page_of_scene(scene: str, at: str = "") -> None:
        with frame(scene):
            ScenePage(replace(tab, scene=scene, state=at or scene)).build()

    @ui.page("/compare/{scene}")
    def page_of_two(scene: str, one: str, other: str) -> None:
        with frame(scene):
            compare(replace(tab, scene=scene), one, other)
