"""How large the viewer's page is and how soon it shows: `python benchmarks/viewer_page.py [PAGE...]
[--pictures DIR]`; without a page, that of the packaged pair, as it is by default and with one
Gaussian a pixel.

In headless Chromium that draws by software; needs playwright and the program chromium. CPU seconds
are those of all processes of the browser from opening the page to its first picture, so they hold
on a busy machine too. With `--pictures`, what people see is saved too: the start, the look before,
turned a little and far, and enlarged.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
from playwright.sync_api import Page, sync_playwright

FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
WIDTH, HEIGHT = 960, 600


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--pictures", type=Path)
    args = parser.parse_args()
    if not args.pages:
        with tempfile.TemporaryDirectory() as folder:
            measure(list(packaged(Path(folder))), args.pictures)
        return
    measure(args.pages, args.pictures)


def packaged(folder: Path) -> Iterator[Path]:
    """Pages of runs of the packaged pair."""
    every = ["--gaussians", "all", "--refine", "0", "--grid", "1"]
    for name, options in {"default": [], "a-pixel-each": every}.items():
        command = [sys.executable, "-m", "edit3r", "run", *options, "--quiet", "--out"]
        subprocess.run([*command, folder / name], check=True)
        yield folder / name / "viewer.html"


def measure(pages: list[Path], save_in: Path | None) -> None:
    """Print a line a page; what people see goes to `save_in`."""
    print(
        "| page | Gaussians | MB | first picture, wall s | CPU s |\n| --- | --: | --: | --: | --: |"
    )
    with sync_playwright() as manager:
        for file in pages:
            browser = manager.chromium.launch(
                executable_path=shutil.which("chromium"), args=FLAGS
            )
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            page.set_default_timeout(300_000)
            start = cpu_seconds()
            page.goto(file.resolve().as_uri())
            page.wait_for_selector("body[data-drawn]")
            spent, count = cpu_seconds() - start, page.evaluate("meta.count")
            wall = int(page.evaluate("document.body.dataset.drawn")) / 1000
            size = file.stat().st_size / 1e6
            print(
                f"| {file.parent.name} | {count:,} | {size:.1f} | {wall:.1f} | {spent:.1f} |",
                flush=True,
            )
            if save_in:
                pictures(page, save_in / (file.parent.name + "-" + file.stem))
            browser.close()


def cpu_seconds() -> float:
    """Of all processes of the browser, which are this process's descendants."""
    total = 0.0
    for process in psutil.Process().children(recursive=True):
        try:
            total += sum(process.cpu_times()[:2])
        except psutil.NoSuchProcess:
            continue
    return total


def pictures(page: Page, base: Path) -> None:
    base.parent.mkdir(parents=True, exist_ok=True)

    def keep(name: str) -> None:
        page.wait_for_function("!flight && !dirty")
        page.screenshot(path=f"{base}-{name}.png")

    def drag(way: float) -> None:
        page.mouse.move(WIDTH / 2, HEIGHT / 4)
        page.mouse.down()
        page.mouse.move(WIDTH / 2 + way, HEIGHT / 4, steps=3)
        page.mouse.up()

    keep("1-start")
    page.keyboard.press("b")
    keep("2-before")
    page.keyboard.press("b")
    drag(80)
    keep("3-turned")
    drag(400)
    keep("4-far")
    page.keyboard.press("2")
    page.wait_for_function("!flight && !dirty")
    page.mouse.move(WIDTH / 2, HEIGHT / 3)
    for _ in range(6):
        page.mouse.wheel(0, -100)
    page.wait_for_timeout(500)
    keep("5-enlarged")


if __name__ == "__main__":
    main()
