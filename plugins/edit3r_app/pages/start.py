"""The first page, and what takes photos."""

import asyncio
import os
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from nicegui import run, ui

from edit3r.contract.weights import ESSENTIALS
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.weights.find import at_hand
from edit3r.loading import declared
from edit3r_app import uploads
from edit3r_app.pages.parts import Event, Tab, address, card, html, img, quiet
from edit3r_app.runner import EDIT3R

TAKEN = (
    f"JPEG, PNG, WebP, TIFF, AVIF{', HEIC' if find_spec('pi_heif') else ''}, or a video; at most "
    f"{uploads.MAX_PHOTOS} photos of {uploads.MAX_BYTES >> 20} MB."
)
GET_ESSENTIALS = (*EDIT3R, "weights", "get", ESSENTIALS, "--yes")
MAX_TOLD = 10  # sentences about refused files


def start(tab: Tab) -> None:
    drop_zone("", "Drop two or more photos of one scene here, or a folder of them")

    def example() -> None:
        pair = [Path(file) for file in packaged_pair()[0]]
        ui.navigate.to(address(uploads.copied(tab.folder, "motorcycle", pair)))

    ui.button("Or try it with two photos of a motorcycle", on_click=example).props(
        "flat"
    )
    scenes = tab.folder.scenes()
    if scenes:
        ui.label("Your scenes").classes("e3-title")
    with html("div", "e3-thumbs"):
        for scene in scenes[:200]:
            photos = [*tab.folder.photos(scene)]
            with ui.link(target=address(scene)).classes("e3-scene"):
                for name in photos[:1]:
                    img(f"/thumbnail/{quote(scene)}/{quote(name)}", scene)
                ui.label(scene).classes("ellipsis")
                quiet(f"{len(photos)} photos, {len(tab.folder.history(scene))} edits")
    essentials(tab)


def drop_zone(scene: str, text: str) -> None:
    """Where photos are dropped or chosen; they go to `scene`, or "" to a new one."""
    with html("div", "e3-drop", data_scene=scene):
        ui.label(text).classes("e3-title")
        with ui.row():
            chooser_of_files("Choose photos", scene)
            chooser_of_files("Choose a folder", scene, "true").props("outline")
        quiet(TAKEN)
    told_of_uploads()


def chooser_of_files(label: str, scene: str, folder: str = "false") -> ui.button:
    choose = f"() => edit3rChoose(decodeURIComponent({quote(scene)!r}), {folder})"
    return ui.button(label).on("click", js_handler=choose)


def told_of_uploads() -> None:
    """Go to the scene when everything was taken; else say what was refused and why."""
    told = ui.column()

    def sending(event: Event) -> None:
        told.clear()
        with told:
            quiet(f"sending {event.args['done'] + 1} of {event.args['total']}")

    def sent(event: Event) -> None:
        refused = [str(sentence)[:500] for sentence in event.args["refused"]]
        scene = str(event.args["scene"])
        if scene and not refused:
            ui.navigate.to(address(scene))
            return
        told.clear()
        with told:
            for sentence in refused[:MAX_TOLD]:
                quiet(sentence, warning=True)
            if len(refused) > MAX_TOLD:
                quiet(f"and {len(refused) - MAX_TOLD} more", warning=True)
            if scene:
                ui.link("Go on with the photos that were taken", address(scene))

    ui.on("edit3r_sending", sending)
    ui.on("edit3r_sent", sent)


def essentials(tab: Tab) -> None:
    """Fetch the weights that make a CPU complete, after their licences were shown."""
    known = declared(()).values()
    missing = [one for one in known if one.essential and at_hand(one) is None]
    if not missing:
        return

    def show_licences() -> None:
        ask.delete()
        with place:
            for one in missing:
                ui.label(f"{one.name}: {one.purpose}")
                quiet(f"licence: {one.terms}; from {one.source}. {one.caution}")
            accept = ui.button("Accept the licences and fetch")
            accept.on_click(partial(_fetch_essentials, tab, accept, ui.log()))

    with card("Essentials") as place:
        count = len(missing)
        size = sum(one.size for one in missing) / 1e6
        quiet(f"{count} small networks ({size:.0f} MB) select and match far better.")
        ask = ui.button("Fetch what makes a CPU complete", on_click=show_licences)
        ask.props("outline")


async def _fetch_essentials(tab: Tab, button: ui.button, output: ui.log) -> None:
    """Fetch them in a process of its own, and say how that ended."""
    button.disable()
    output.classes("e3-log").clear()
    child = await asyncio.create_subprocess_exec(
        *GET_ESSENTIALS,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    async for line in child.stdout:
        output.push(line.decode(errors="replace"))
    if await child.wait():
        output.push("Not fetched, for the reason above. Press again to go on.")
        button.enable()
        return
    await run.io_bound(tab.looker.renew)
    output.push("Done: the next click uses them.")
