"""The first page, and what takes photos."""

import asyncio
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from nicegui import ui

from edit3r.io.images import packaged_pair
from edit3r_app import uploads
from edit3r_app.pages.parts import Event, Tab, address, html, img, quiet
from edit3r_app.runner import EDIT3R

TAKEN = (
    f"JPEG, PNG, WebP, TIFF, AVIF{', HEIC' if find_spec('pi_heif') else ''}, or a video; at most "
    f"{uploads.MAX_PHOTOS} photos of {uploads.MAX_BYTES >> 20} MB."
)
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
    essentials()


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


def essentials() -> None:
    """Fetch the weights that make selecting by click and word good, after their licences."""
    with ui.expansion("Essentials: small networks that select far better"):
        output = ui.log().classes("e3-log")

        async def fetch(*more: str) -> None:
            output.clear()
            command = (*EDIT3R, "weights", "get", "essentials", *more)
            pipe = asyncio.subprocess.PIPE
            child = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=pipe,
                stderr=asyncio.subprocess.STDOUT,
            )
            async for line in child.stdout:
                output.push(line.decode(errors="replace"))
            failed = await child.wait()
            accept.set_enabled(True)
            output.push("not fetched" if failed else "done")

        with ui.row():
            ui.button("Show licences", on_click=lambda: fetch())
            accept = ui.button("Accept and fetch", on_click=lambda: fetch("--yes"))
            accept.set_enabled(False)
