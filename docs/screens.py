"""The sheets of the app's screens in docs/app.md, at both sizes and in both themes.

    python docs/screens.py [--out docs/images] [--size 384]

Needs playwright and Chromium, as the tests of the app do. Takes some minutes on two cores.
"""

import argparse
import contextlib
import io
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from edit3r_app.phone import phone_link
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from edit3r.kit.photos.images import packaged_pair

SHEETS = {"app-result": ((1280, 800), 3, 440), "app-phone": ((390, 844), 4, 250)}
"""Of each: the window's size, how many stand beside each other, and how wide each is [pixels]."""
GAP = 8  # [pixels]
GROUND = "#80808a"
SOFTWARE_GL = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader")
EXAMPLE = phone_link("192.168.1.20", 8090, "example-token", "/s/motorcycle")


@contextlib.contextmanager
def app(jobs: Path, size: int) -> Iterator[str]:
    """The address of an app that keeps its jobs in a folder."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "edit3r", "app", "--no-browser"]
    command += ["--size", str(size), "--port", str(port), "--jobs", str(jobs)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    address = f"http://localhost:{port}"
    try:
        while server.poll() is None:
            with contextlib.suppress(OSError):
                urllib.request.urlopen(f"{address}/static/app.css").close()
                break
            time.sleep(0.2)
        yield address
    finally:
        server.terminate()
        server.wait()


def screens(page: Page, address: str) -> Iterator[str]:
    """Lead the page from screen to screen; yields the theme of each that is to be kept."""
    page.goto(address)
    page.locator(".try img").last.wait_for()
    yield "light"
    with page.expect_file_chooser() as choosing:
        page.get_by_text("Choose photos").click()
    choosing.value.set_files(packaged_pair()[0])
    page.wait_for_function("document.querySelector('.box .base')?.naturalWidth > 0")
    place = page.locator(".box").bounding_box()  # and on it the tank
    tank = {"x": 0.5 * place["width"], "y": 0.45 * place["height"]}
    page.locator(".box").click(position=tank)
    page.get_by_label("what to change").fill("paint it green")
    page.locator(".line", has_text="edit: ").wait_for(timeout=200_000)
    yield "dark"
    yield from dialogs(page, "what else may be meant", "settings")
    page.get_by_role("button", name="Go", exact=True).click()
    viewer = page.frame_locator(".stage iframe")
    viewer.locator("body.pointing[data-drawn]").wait_for()
    frame = next(one for one in page.frames if "/viewer/" in one.url)
    where = "[[0.5 * canvas.clientWidth, 0.55 * canvas.clientHeight]]"
    frame.evaluate(f"tell({{pointed: point({where})}})")
    page.wait_for_function("document.querySelector('.chip svg')")
    viewer.locator("#heard").wait_for(state="hidden")
    page.locator(".pill").wait_for(state="hidden")
    yield "light"
    page.get_by_role("button", name="things", exact=True).click()
    page.get_by_label("name of the new thing").fill("motorcycle")
    page.get_by_role("button", name="Take", exact=True).click()
    viewer.locator("#gizmo button").first.wait_for()
    yield "dark"
    yield from dialogs(page, "history", "download")
    if page.viewport_size["width"] > 720:
        page.get_by_role("button", name="download").click()
        page.get_by_role("button", name="Open it on a phone").press("Enter")
        page.locator(".code svg").wait_for()
        yield "dark"


def dialogs(page: Page, *names: str) -> Iterator[str]:
    """What opens by these buttons, one after the other."""
    for name in names:
        page.get_by_role("button", name=name).first.click()
        page.wait_for_timeout(1500)
        yield "light"
        page.keyboard.press("Escape")


def shots(address: str, size: tuple[int, int]) -> Iterator[Image.Image]:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=SOFTWARE_GL
        )
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(200_000)
        page.route("**/api/phone", lambda route: route.fulfill(json=EXAMPLE))
        for theme in screens(page, address):
            page.evaluate(f"document.documentElement.dataset.theme = '{theme}'")
            page.wait_for_timeout(300)
            yield Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        browser.close()


def sheet(images: list[Image.Image], columns: int, width: int) -> Image.Image:
    """All images beside and below each other."""
    height = round(width * images[0].height / images[0].width)
    rows = -(-len(images) // columns)
    area = (GAP + columns * (width + GAP), GAP + rows * (height + GAP))
    made = Image.new("RGB", area, GROUND)
    for k, image in enumerate(images):
        row, column = divmod(k, columns)
        small = image.resize((width, height), Image.Resampling.LANCZOS)
        made.paste(small, (GAP + column * (width + GAP), GAP + row * (height + GAP)))
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "images")
    parser.add_argument("--size", type=int, default=384)
    args = parser.parse_args()
    for name, (window, columns, width) in SHEETS.items():
        with tempfile.TemporaryDirectory() as folder:
            with app(Path(folder) / "jobs", args.size) as address:
                images = list(shots(address, window))
            made = sheet(images, columns, width)
            made.save(args.out / f"{name}.jpg", quality=82)


if __name__ == "__main__":
    main()
