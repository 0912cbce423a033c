"""The way of a person through the app: drop two photos, point, say, see, compare, download.

    python benchmarks/app_way.py [--size 384] [--phone]

The packaged pair in headless Chromium that draws by software, networks not yet loaded. For each
step the seconds of the clock, and of the processor in the app and its runs and in the browser.
Needs playwright and Chromium, as the tests of the app do.
"""

import argparse
import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from screens import SOFTWARE_GL, app

from edit3r.kit.photos.images import packaged_pair

PATIENCE = 300_000  # [ms]
ALL = "in all"
TANK = 0.55, 0.4  # of the motorcycle, in shares of the photo


class Watch:
    """Seconds since the step before, of the clock and of processes that may have ended."""

    def __init__(self) -> None:
        self.spent: dict[int, tuple[str, float]] = {}
        threading.Thread(target=self._follow, daemon=True).start()
        self.begun = self.last = time.perf_counter()
        self.before = self.first = self.processor()

    def _follow(self) -> None:
        while True:  # what a process used is known as long as it lives
            self.processor()
            time.sleep(0.2)

    def processor(self) -> tuple[float, float]:
        """In the app and in the browser, [s]."""
        for one in psutil.Process(os.getpid()).children(recursive=True):
            try:
                used = one.cpu_times()
                kind = "browser" if "chrom" in one.name() else "app"
                self.spent[one.pid] = (kind, used.user + used.system)
            except psutil.Error:
                continue
        spent = list(self.spent.values())
        return tuple(
            sum(used for kind, used in spent if kind == wanted)
            for wanted in ("app", "browser")
        )

    def step(self, name: str) -> None:
        now, used = time.perf_counter(), self.processor()
        begun, before = (
            (self.begun, self.first) if name == ALL else (self.last, self.before)
        )
        app, browser = (a - b for a, b in zip(used, before))
        print(
            f"{name:28s} {now - begun:6.1f} s   CPU {app:5.1f} s   browser {browser:5.1f} s",
            flush=True,
        )
        self.last, self.before = now, used


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=384, help="of the photos [pixels]")
    parser.add_argument("--phone", action="store_true", help="at 390 x 844")
    args = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as place,
        app(Path(place) / "jobs", args.size) as address,
        sync_playwright() as driver,
    ):
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=SOFTWARE_GL
        )
        page = browser.new_page(accept_downloads=True)
        page.set_default_timeout(PATIENCE)
        size = (390, 844) if args.phone else (1280, 800)
        page.set_viewport_size(dict(zip(("width", "height"), size)))
        page.goto(address)
        page.locator(".try img").last.wait_for()
        watch = Watch()
        with page.expect_file_chooser() as choosing:
            page.get_by_text("Choose photos").click()
        choosing.value.set_files(packaged_pair()[0])
        page.wait_for_function("document.querySelector('.box .base')?.naturalWidth > 0")
        watch.step("drop")
        box = page.locator(".box").bounding_box()
        page.locator(".box").click(
            position={"x": TANK[0] * box["width"], "y": TANK[1] * box["height"]}
        )
        page.wait_for_function("document.body.dataset.outlined")
        watch.step("point, until the outline")
        page.get_by_label("what to change").fill("paint it golden")
        page.locator(".line", has_text="edit: ").wait_for()
        watch.step("say, until the verdict")
        page.get_by_role("button", name="Go", exact=True).click()
        page.locator(".stage iframe").wait_for()
        watch.step("see: the run")
        viewer = page.frame_locator(".stage iframe")
        viewer.locator("body[data-drawn]").wait_for()
        watch.step("see: the scene drawn")
        viewer.locator("#cut").press("ArrowLeft")
        watch.step("compare")
        page.get_by_role("button", name="download").click()
        file = page.locator(".file", has_text="viewer.html")
        file.get_by_text(" kB").wait_for()
        with page.expect_download() as loading:
            file.press("Enter")
        loading.value.path()
        watch.step("download")
        watch.step(ALL)


if __name__ == "__main__":
    main()
