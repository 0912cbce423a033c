"""Editor, reconstructor, quality, and all their settings, from what the components declare."""

from collections.abc import Iterable
from functools import partial

from nicegui import ui

from edit3r.running import PRESETS
from edit3r_app.draft import Draft
from edit3r_app.forms import CHOSEN, form_lines, in_words, offered
from edit3r_app.pages.parts import Event, Tab, quiet

UNSAID = "automatic"


class SettingsForm:
    """The part of a draft's form that most leave alone."""

    def __init__(self, tab: Tab) -> None:
        self.tab = tab
        self.registry = tab.looker.registry

    def build(self) -> None:
        with ui.expansion("Editor, reconstructor, quality and their settings"):
            with ui.row():
                for kind in CHOSEN:
                    self._choice(kind, offered(self.registry, kind))
                self._choice("quality", PRESETS)
            self.lines()

    def _choice(self, key: str, names: Iterable[str]) -> None:
        chosen = self.tab.draft.form.get(key)
        ui.select(
            [UNSAID, *names],
            value=chosen if chosen in names else UNSAID,
            label=key,
            on_change=partial(self._choose, key),
        ).classes("e3-choice")

    def _choose(self, key: str, event: Event) -> None:
        name = "" if event.value == UNSAID else event.value
        self.tab.edit(lambda draft: draft.form.update({key: name}))
        self.lines.refresh()

    @ui.refreshable_method
    def lines(self) -> None:
        """The settings of what is chosen, and of the run."""
        for kind in CHOSEN:
            name = self.tab.draft.form.get(kind)
            offers = offered(self.registry, kind)
            if name in offers:
                ui.label(f"{name}: {offers[name]}")
                self._group(kind, name, f"{kind} {name}")
        with ui.expansion("Settings of the run"):
            self._group("run", "", "run")

    def _group(self, kind: str, name: str, group: str) -> None:
        typed = self.tab.draft.form.get("settings", {}).get(group, {})
        for line in form_lines(self.registry, kind, name):
            text = ui.input(line.name, value=typed.get(line.name, ""))
            text.on_value_change(partial(self._type, group, line.name))
            text.props("debounce=400").classes("w-full")
            quiet(in_words(line))

    def _type(self, group: str, name: str, event: Event) -> None:
        def change(draft: Draft) -> None:
            groups = draft.form.setdefault("settings", {})
            groups.setdefault(group, {})[name] = event.value

        self.tab.edit(change)
