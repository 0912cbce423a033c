"""The app in a real browser, at the size of a desktop and of a phone: from dropped photos to a
download, with a second tab and a server that is killed.

Skipped where Playwright or Chromium is missing: `pip install playwright`, and Chromium of the
system or of `playwright install chromium`.
"""

import contextlib
import re
import shutil
import signal
import sys
import threading
import time
import urllib.error
import urllib.request
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from edit3r_app.draft import read_draft
from edit3r_app.jobs import JobsFolder

from edit3r.cli.main import main
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import load_ply, save_ply
from tests.edit3r.running.test_measuring import BASELINE, baseline, truth
from tests.plugins.scan import scan

from ..looks import AXE_FILE, PHONE, WIDE, cut_off, serious
from .conftest import Server

pytestmark = pytest.mark.slow

playwright = pytest.importorskip(
    "playwright.sync_api", reason="needs playwright, see this file's docstring"
)
pytest.importorskip("uvicorn", reason='needs the app: pip install "edit3r[app]"')


def upload(page, files):
    with page.expect_file_chooser() as choosing:
        page.get_by_text("Choose photos").click()
    choosing.value.set_files(files)


def drop(page, server):
    """Photos, up to the page of their scene."""
    page.goto(server.address)
    upload(page, packaged_pair()[0])
    page.wait_for_url("**/s/**")
    page.wait_for_function("document.querySelector('.box .base')?.naturalWidth > 0")
    return page.url


def share_of_the_scene(page):
    """Of the window's area."""
    return page.evaluate(
        """() => {
          const {width, height} = document.querySelector(".stage").getBoundingClientRect();
          return width * height / innerWidth / innerHeight;
        }"""
    )


def within_reach(page):
    """Whether the sentence and Go lie in the window, and every button is large enough."""
    return page.evaluate(
        """() => {
          const go = document.querySelector(".bar .primary").getBoundingClientRect();
          const buttons = [...document.querySelectorAll(".top button, .dock button")];
          const areas = buttons.map((one) => one.getBoundingClientRect());
          const shown = areas.filter((one) => one.width);
          return go.bottom <= innerHeight && go.right <= innerWidth
            && document.documentElement.scrollWidth <= innerWidth
            && shown.every((one) => Math.min(one.width, one.height) >= 40);
        }"""
    )


def shifts(page):
    """How far things moved after they were laid out (CLS)."""
    return page.evaluate("window.shifted")


def things_of_the_scene(page, viewer):
    """What is marked is taken as a thing, its handle asks for a turn, and all is undone."""

    def after(act):
        before = page.url
        act()
        page.wait_for_url(lambda address: address != before)
        viewer.locator("body[data-drawn]").wait_for()

    first = page.url
    page.get_by_role("button", name="things").click()
    name = page.get_by_label("name of the new thing")
    name.fill("it")
    # By a key: without a GPU a click on what has just opened over a frame may go to that frame.
    after(lambda: name.press("Enter"))
    page.locator(".things .chosen", has_text="it").wait_for()
    viewer.locator("#gizmo").get_by_role("button").first.wait_for()
    # what was done is said
    page.get_by_text("it is a thing of the scene now").wait_for()
    taken = page.url.partition("at=")[2]
    asked = []  # what turning makes is asked by the tests of `edit3r objects`

    def turned(route):
        asked.append(route.request.post_data_json)
        page.locator(".pill", has_text="it: turning it").wait_for()
        route.fulfill(json=taken)

    page.route("**/api/object/**", turned, times=1)
    viewer.get_by_label("turn; arrow keys").press("ArrowRight")
    page.get_by_text("it is turned").wait_for()
    page.locator(".pill").wait_for(state="hidden")  # nothing is waited for any more
    assert (asked[0]["at"], asked[0]["action"], asked[0]["name"]) == (
        taken,
        "turn",
        "it",
    )
    after(lambda: page.locator(".drawer h2").press("Control+z"))
    assert page.url == first
    page.get_by_role("button", name="things", exact=True).click()


def mark_beside_an_older_answer(page, act):
    """A poll that was answered before a mark, and arrives after it, does not hide the mark."""
    held = []
    polls = "**/api/scene/**"
    page.route(polls, lambda route: held.append((route, route.fetch())), times=1)
    while not held:
        page.wait_for_timeout(50)
    page.evaluate(
        """() => {
          const chip = document.querySelector(".chip");
          window.chips = [];
          new MutationObserver(() => window.chips.push(chip.textContent))
            .observe(chip, {childList: true});
        }"""
    )
    act()
    page.locator(".chip", has_text="what you marked").wait_for()
    route, answer = held[0]
    with page.expect_request(polls):  # the next one, after the held one was drawn
        route.fulfill(response=answer)
    assert "nothing marked" not in page.evaluate("window.chips")


def click_photo(page, x=0.5, y=0.5):
    place = page.locator(".box").bounding_box()
    page.mouse.click(place["x"] + x * place["width"], place["y"] + y * place["height"])
    page.wait_for_function("document.body.dataset.outlined")


@pytest.mark.skipif(sys.platform == "win32", reason="restarting needs flock")
def test_from_photos_to_a_download(server, tab):
    page = tab()
    scene_address = drop(page, server)
    assert share_of_the_scene(page) >= 0.6 and within_reach(page)

    page.get_by_role("button", name="Go", exact=True).click()
    page.get_by_text("Say first what should change").wait_for()
    click_photo(page)
    assert page.locator(".toast").count() == 0, "who goes on has read it"
    for _ in range(2):  # shown in the strip, on both photos
        page.wait_for_function(
            "[...document.querySelectorAll('.strip .over')].every((one) => one.naturalWidth > 1)"
        )
    page.get_by_label("what to change").fill("paint it blue")
    page.get_by_text("edit: ").wait_for()  # the verdict on it, before Go
    page.get_by_role("button", name="Go", exact=True).click()
    page.wait_for_url("**at=**")
    page.locator(".pill progress").wait_for()  # where it stands is said
    page.locator(".stage iframe").wait_for()
    assert share_of_the_scene(page) >= 0.6 and within_reach(page)
    run = page.url.partition("at=")[2]
    phone = tab((390, 844))
    for address in (page.url, scene_address):
        phone.goto(address)
        shown = ".stage iframe" if address == page.url else ".box .base"
        phone.locator(shown).wait_for()
        assert share_of_the_scene(phone) >= 0.6 and within_reach(phone)
        assert shifts(phone) <= 0.05
    phone.close()
    page.set_viewport_size({"width": 800, "height": 500})  # is drawn in half the time

    # the scene in 3D, a handle between before and after
    viewer = page.frame_locator(".stage iframe")
    viewer.locator("body[data-drawn]").wait_for()
    viewer.locator("#cut").press("ArrowLeft")
    assert viewer.locator("#cut").get_attribute("aria-valuenow") == "45"
    sandboxed = "document.querySelector('.stage iframe').contentDocument"
    assert page.evaluate(sandboxed) is None, "it has an origin of its own"

    # a click on the scene is one on the photo that shows the place, and is tinted there
    viewer.locator("body.pointing").wait_for()  # told when its page is loaded
    # Told by the scene's page: Chromium without a GPU leads not every click into a sandboxed frame.
    # What a click there tells is asked by the viewer's own test.
    scene_page = next(frame for frame in page.frames if "/viewer/" in frame.url)
    scene_page.evaluate(
        "tell({pointed: point([[0.6 * canvas.clientWidth, canvas.clientHeight / 2]])})"
    )
    viewer.locator("body[data-marked]").wait_for()
    page.locator(".chip", has_text="what you marked").wait_for()
    # so is, where a mouse rests, what a click would take
    rests = "resting = true, tell({rests: point([[200, 200]])}), document.body.dataset.meant"
    scene_page.wait_for_function(rests, polling=2000)
    things_of_the_scene(page, viewer)

    # downloads, each with what it is for and its size
    page.get_by_role("button", name="download").click()
    page.locator(".file", has_text="viewer.html").get_by_text(" kB").wait_for()
    with page.expect_download() as loading:
        page.locator(".file", has_text="all.zip").press("Enter")
    names = zipfile.ZipFile(loading.value.path()).namelist()
    assert {f"{run}/scene.ply", f"{run}/viewer.html", f"{run}/run.json"} <= set(names)
    page.keyboard.press("Escape")

    # back to the photos by the history; everything is there after a reload
    page.get_by_role("button", name="history").click()
    page.locator(".drawer a", has_text="The photos as they are").press("Enter")
    page.wait_for_url(scene_address)
    page.reload()
    page.wait_for_function("document.querySelector('.box .over')?.naturalWidth > 1")
    assert page.get_by_label("what to change").input_value() == "paint it blue"
    assert shifts(page) <= 0.05

    page.goto(server.address)  # who comes back sees the own scenes first
    page.get_by_role("heading", name="Your scenes").wait_for()
    first = page.locator("main section").nth(1)
    assert first.get_by_role("heading").first.inner_text() == "Your scenes"
    assert shifts(page) <= 0.05
    assert tab.problems == []


@pytest.mark.skipif(sys.platform == "win32", reason="restarting needs flock")
def test_marks_by_stroke_box_keys_and_two_tabs(server, tab):
    page, folder = tab(), JobsFolder(server.folder)
    address = drop(page, server)
    scene = address.rpartition("/")[2]

    def kinds(expected):
        for _ in range(600):
            found = [one.kind for one in read_draft(folder, scene).marks]
            if found == expected:
                return
            time.sleep(0.1)
        raise AssertionError(f"{found} instead of {expected}")

    def drag(tool, shift=False):
        page.keyboard.press(tool)
        place = page.locator(".box").bounding_box()
        if shift:
            page.keyboard.down("Shift")
        page.mouse.move(place["x"] + 60, place["y"] + 60)
        page.mouse.down()
        page.mouse.move(place["x"] + 160, place["y"] + 130, steps=5)
        assert page.locator(".marks :is(polyline, polygon, rect)").count() == 1
        page.mouse.up()
        page.keyboard.up("Shift")

    drag("l")
    kinds(["lasso"])
    page.locator(".chip", has_text="what you marked").wait_for()
    page.keyboard.press("n")  # kept by a name, to be taken again
    page.get_by_label("name of what is marked").fill("door")
    page.keyboard.press("Enter")
    page.locator(".names", has_text="door").wait_for()
    page.keyboard.press("Escape")
    page.keyboard.press("Control+z")
    kinds([])
    page.keyboard.press("n")
    page.get_by_role("button", name="door", exact=True).click()
    kinds(["lasso"])
    page.keyboard.press("Control+z")
    drag("p")
    kinds(["stroke"])
    drag("r", shift=True)
    kinds(["stroke", "erase"])
    page.keyboard.press("b")
    page.keyboard.press("e")
    drag("b")
    kinds(["stroke", "erase", "exact"])
    page.keyboard.press("Control+z")
    kinds(["stroke", "erase"])
    page.keyboard.press("Control+y")
    kinds(["stroke", "erase", "exact"])
    page.keyboard.press("i")
    kinds(["stroke", "erase", "exact", "invert"])
    other = tab()  # what one tab marks another shows
    other.goto(address)
    other.locator(".chip", has_text="what you marked").wait_for()
    for width in (390, 744, 900, 1100, 1280):  # tablets are between phones and desks
        page.set_viewport_size({"width": width, "height": 800})
        go, said = (
            page.locator(f".bar {one}").bounding_box() for one in (".primary", "input")
        )
        assert go["x"] + go["width"] <= width and said["width"] > 120
    page.locator(".chip").click()
    kinds([])
    other.locator(".chip", has_text="nothing marked").wait_for()
    page.keyboard.press("p")
    page.locator(".box").focus()
    page.keyboard.press("ArrowLeft")
    mark_beside_an_older_answer(page, lambda: page.keyboard.press("Enter"))
    kinds(["add"])
    page.locator(".chip").click()
    kinds([])
    assert tab.problems == []


def test_what_is_asked_while_photos_arrive_begins_with_all_of_them(server, tab):
    page = tab()
    held = []  # all but the first photo
    page.route(re.compile("/upload/[^-]"), lambda route: held.append(route))
    scene = drop(page, server).rpartition("/")[2]
    page.get_by_label("what to change").fill("make everything grey")
    page.get_by_label("what to change").press("Enter")
    page.get_by_text("Begins when all photos are here").wait_for(timeout=10_000)
    assert "at=" not in page.url
    held[0].continue_()
    page.wait_for_url("**at=**")
    assert len(list((server.folder / scene / "images").iterdir())) == 2


def test_an_edit_outlives_a_server_that_is_killed(server, tab):
    page = tab()
    drop(page, server)
    page.get_by_label("what to change").fill("make everything grey")
    page.get_by_label("what to change").press("Enter")  # at once, as people who type do
    page.wait_for_url("**at=**")
    for _ in range(600):
        if any(job.state == "running" for job in JobsFolder(server.folder).jobs()):
            break
        time.sleep(0.1)
    server.kill(signal.SIGKILL)
    page.get_by_text("does not answer").first.wait_for()
    server.start()
    page.locator(".stage iframe").wait_for()  # without a reload


def beside_each_other(page):
    """Whether the open panel covers nothing of the scene, and the window holds both."""
    return page.evaluate(
        """() => {
          const [a, b] = [".middle", ".drawer"].map((one) =>
            document.querySelector(one).getBoundingClientRect());
          const over = Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
            && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
          return !over && Math.max(a.right, b.right) <= innerWidth && a.height >= innerHeight / 4;
        }"""
    )


def drawn_3d(page):
    viewer = page.frame_locator(".stage iframe")
    viewer.locator("body[data-drawn]").wait_for()
    viewer.locator("body.pointing").wait_for()
    return next(frame for frame in page.frames if "/viewer/" in frame.url)


def test_a_dropped_splat_is_turned_clicked_changed_undone_and_exported(
    server, tab, tmp_path
):
    save_ply(tmp_path / "balls.ply", scan())
    page = tab((800, 500))
    page.goto(server.address)
    upload(page, [str(tmp_path / "balls.ply")])
    page.wait_for_url("**/s/balls*")
    scene = page.url
    page.get_by_label("which way is up").wait_for()
    page.get_by_role("button", name="3D", exact=True).click()
    frame = drawn_3d(page)
    assert page.locator(".gestures").inner_text().startswith("Drag to turn")
    frame.evaluate("orbit(0.3, 0)")
    frame.evaluate(
        "tell({pointed: point([[canvas.clientWidth * 0.4, canvas.clientHeight / 2]])})"
    )
    page.locator(".chip", has_text="marked").wait_for()
    frame.wait_for_function("document.body.dataset.marked > 50", polling=200)
    said = page.get_by_label("what to change")
    said.fill("make it night")  # what is understood is what will be done
    page.get_by_text("Understood: what you marked: night").wait_for()
    said.fill("paint it blue")
    page.get_by_text("Understood: it: blue").wait_for()
    page.get_by_role("button", name="Go", exact=True).click()
    page.wait_for_url("**at=**")
    page.locator(".pill progress[value]").wait_for()  # at the first edit, too
    drawn_3d(page)
    edited = page.url

    page.get_by_role("button", name="download").click()
    with page.expect_download() as loading:
        page.locator(".file", has_text="scene.ply").press("Enter")
    before, after = (
        load_ply(one) for one in (tmp_path / "balls.ply", loading.value.path())
    )
    changed = (before.harmonics != after.harmonics).flatten(2).any(2)[0]
    red, rest = changed[:300].float().mean(), changed[300:].float().mean()
    assert red > 0.8 and rest < 0.1
    page.get_by_role("button", name="Film a flight").press("Enter")
    page.get_by_text("Add at least two views").wait_for()
    assert beside_each_other(page)

    phone = tab((390, 844))
    phone.goto(edited)
    drawn_3d(phone)
    assert phone.locator(".verdicts .badge").count() == 1
    assert phone.locator(".verdicts").bounding_box()["height"] < 50
    hint = phone.locator(".gestures").bounding_box()
    assert hint["x"] >= 0 and hint["x"] + hint["width"] <= 390
    phone.get_by_role("button", name="things", exact=True).click()
    phone.get_by_role("heading", name="Things").wait_for()
    assert beside_each_other(phone)
    phone.close()

    page.get_by_role("button", name="close").first.press("Enter")
    page.get_by_role("button", name="undo").first.click()
    page.wait_for_url(scene)
    page.locator(".chip", has_text="marked").wait_for()  # shown, as it is meant
    assert said.input_value() == "paint it blue"
    page.goto(server.address)
    card = page.locator(".scenes li", has_text="balls").locator("a")
    assert card.get_attribute("href") == scene.removeprefix(server.address)
    assert tab.problems == []


class Proxy(BaseHTTPRequestHandler):
    """A page's server that has the app under a path, as nginx passes it on: with another host."""

    to = ""

    def do_GET(self):
        size = int(self.headers.get("content-length") or 0)
        headers = {
            name: value for name, value in self.headers.items() if name != "Host"
        }
        body = self.rfile.read(size) if size else None
        path = self.path.removeprefix("/lab/edit3r")
        self.asked.append(self.path)
        passed = urllib.request.Request(
            self.to + path, body, headers, method=self.command
        )
        plain = urllib.request.build_opener(urllib.request.ProxyHandler({}), Stays)
        try:
            answer = plain.open(passed)
        except urllib.error.HTTPError as error:
            answer = error
        content = answer.read()
        self.send_response(answer.status)
        for name, value in answer.headers.items():
            if name.lower() not in ("transfer-encoding", "content-length"):
                self.send_header(name, value)
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    do_POST = do_GET

    def log_message(self, *_):
        pass


ENDS = ((190, 300), (540, 150))  # of the packaged pair, on the left photo: far apart
SURFACE = """([x, y]) => {
  const {focal, principal} = pixels(lens), share = canvas.width / canvas.clientWidth;
  const sight = [(x * lens.width - lens.cx) / lens.fx, (y * lens.height - lens.cy) / lens.fy];
  measureTo(solid(...sight.map((at, k) => (focal[k] * at + principal[k]) / share)));
}"""


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_a_length_that_is_typed_makes_the_scene_metric(server, tab, size):
    """The calibrated pair's cameras stand 193 mm apart; told is the true length between two places
    that its disparities give. A length that is none changes nothing, and Escape ends it.
    """
    run = server.folder / "bike"
    if not run.exists():
        words = ["run", "--editor", "none", "--outputs", "scene,images,viewer"]
        assert main([*words, "--quiet", "--out", str(run)]) == 0
    page = tab(size)
    page.goto(f"{server.address}/s/bike")

    def measure():
        frame = page.frame_locator(".stage iframe")
        frame.locator("body[data-drawn]").wait_for()
        page.get_by_role("button", name="Ruler").click()
        frame.locator("body.measuring").wait_for()
        page.get_by_text("Click two places in the scene").wait_for()
        scene_page = next(one for one in page.frames if "/viewer/" in one.url)
        for x, y in ENDS:  # as a click there does
            scene_page.evaluate(SURFACE, [(x + 0.5) / 741, (y + 0.5) / 500])
        page.get_by_label("how long it is in truth").wait_for()
        return page.locator("form.question strong").inner_text()

    assert measure().endswith(" units in the scene")
    assert cut_off(page, [".question", ".question small"]) == []
    typed, use = (
        page.get_by_label("how long it is in truth"),
        page.get_by_text("Use it"),
    )
    typed.fill("3 yards")
    use.click()
    page.get_by_text("got the unit 'yards'").wait_for()
    first, second = (truth(*place) for place in ENDS)
    told = np.linalg.norm(first - second)
    typed.fill(f"{100 * told:.2f} cm")
    use.click()
    page.wait_for_url("**at=**")
    made = server.folder / page.url.partition("at=")[2]
    assert baseline(made) == pytest.approx(BASELINE, rel=0.03)
    length, unit = measure().split()[:2]
    assert unit == "m" and float(length) == pytest.approx(told, rel=0.005)
    page.keyboard.press("Escape")
    page.locator("form.question").wait_for(state="hidden")
    page.frame_locator(".stage iframe").locator("body:not(.measuring)").wait_for()
    # the edit before is there again
    page.get_by_role("button", name="Undo").locator("visible=true").click()
    page.wait_for_url(lambda address: "at=" not in address or "bike-" not in address)
    page.close()
    asked = [one for one in tab.problems if "400" not in one]
    assert asked == []


class Stays(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_):
        return None


def test_below_a_proxys_path_and_ended_while_it_reads_photos(browser, tmp_path):
    folder = tmp_path / "jobs"
    weights = str(tmp_path / "weights")
    below = Server(
        folder,
        *("--root-path", "/lab/edit3r/"),
        EDIT3R_WEIGHTS=weights,
        EDIT3R_APP_TOKEN="word",
    )
    handler = type("To", (Proxy,), {"to": below.address, "asked": []})
    proxy = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=proxy.serve_forever, daemon=True).start()
    start = f"http://localhost:{proxy.server_port}/lab/edit3r/"
    context = browser.new_context()
    try:
        page = context.new_page()
        page.goto(f"{start}?token=word")
        assert page.url == start
        upload(page, packaged_pair()[0])
        page.wait_for_url(f"{start}s/**")
        page.wait_for_function("document.querySelector('.box .base')?.naturalWidth > 0")
        page.reload()
        page.locator(".thumb").nth(1).wait_for()
        page.get_by_title("all scenes").click()
        page.locator(".scenes .name", has_text="motorcycle").first.wait_for()
        assert all(one.startswith("/lab/edit3r/") for one in handler.asked)
        below.process.send_signal(signal.SIGINT)
        assert below.process.wait(timeout=10) == 0
    finally:
        context.close()
        proxy.shutdown()
        below.process.kill()


PHOTO_VIEWS = {
    "settings": "Settings",
    "history": "History",
    "keys": "Keys",
    "keep what is marked": "Selections",
}
SCENE_VIEWS = {"things": "Things", "history": "History", "download": "Download"}
"""What opens beside photos and beside a scene: the button, and the title."""


@pytest.mark.skipif(not AXE_FILE, reason="needs axe-core: EDIT3R_AXE=axe.min.js")
@pytest.mark.parametrize(
    "theme, size",
    [("dark", (1280, 800)), ("light", (1280, 800)), ("light", (390, 844))],
    ids=["dark", "light", "phone"],
)
def test_nothing_serious_for_those_who_do_not_see_or_point(server, tab, theme, size):
    page = tab(size)
    page.add_init_script(f"localStorage.setItem('edit3r-theme', '{theme}')")

    def check():
        assert serious(page) == []

    page.goto(server.address)
    page.get_by_text("Photos that work").wait_for()
    check()
    drop(page, server)
    check()

    def open_and_check(name, title):
        # By a key: the next click after a dialog opened may go into the frame below it.
        page.get_by_role("button", name=name).first.press("Enter")
        heading = page.locator(":is(dialog, .drawer) h2", has_text=title)
        heading.wait_for()
        check()
        page.keyboard.press("Escape")
        heading.wait_for(state="hidden")

    click_photo(page)
    for name, title in PHOTO_VIEWS.items():
        if page.get_by_role(
            "button", name=name
        ).first.is_visible():  # no keys on phones
            open_and_check(name, title)
    page.goto(server.address)
    page.locator(".try", has_text="night").click()  # a made scene
    page.locator(".stage iframe").wait_for()
    check()
    for name, title in SCENE_VIEWS.items():
        open_and_check(name, title)
    for name in ("Film a flight", "Open it on a phone"):
        page.get_by_role("button", name="download").press("Enter")
        open_and_check(name, name)


def test_essentials_show_licences_and_say_that_no_network_is_there(server, tab):
    page = tab()
    page.goto(server.address)
    page.get_by_text("Fetch what makes a CPU complete").click()
    page.get_by_text("licence: Apache-2.0").first.wait_for()
    assert not (server.folder.parent / "weights").exists()
    accept = page.get_by_text("Accept the licences and fetch")
    accept.click()
    page.get_by_text("Not fetched, for the reason above").wait_for()
    assert page.get_by_text("pip could not fetch").count() >= 1
    assert accept.is_enabled()


def test_refused_files_are_said_and_shown_as_text(server, tab, tmp_path):
    bad = tmp_path / "<img src=x onerror=alert(1)>.png"
    bad.write_text("<html><script>alert(1)</script>")
    (tmp_path / "x.svg").write_text("<svg onload='alert(1)'/>")
    page = tab()
    page.goto(server.address)
    before = sorted(path.name for path in server.folder.iterdir())
    upload(page, [str(bad), str(tmp_path / "x.svg")])
    page.get_by_text("not an image that can be read").wait_for()
    page.get_by_text("x.svg: not a photo by its name").wait_for()
    assert page.locator("img[src=x]").count() == 0
    assert sorted(path.name for path in server.folder.iterdir()) == before
    assert [text for text in tab.problems if "400" not in text] == []


HOSTILE = """<body><script>
const got = [], url = "http://127.0.0.1:PORT/";
try { got.push(parent.document.title) } catch {}
try { got.push(localStorage.length) } catch {}
try { top.location = url } catch {}
if (open(url)) got.push("a window");
fetch("/api/home").then(() => got.push("answers"), () => {}).then(() => {
  document.body.dataset.got = got;
});
</script>"""


def test_a_strangers_page_reads_nothing_and_leads_nowhere(server, tab):
    run = server.folder / "strange"
    (run / "inputs").mkdir(parents=True)
    shutil.copy(packaged_pair()[0][0], run / "inputs")
    (run / "run.json").write_text("{}")
    asked = []

    class Listener(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)

    elsewhere = ThreadingHTTPServer(("127.0.0.1", 0), Listener)
    threading.Thread(target=elsewhere.serve_forever, daemon=True).start()
    hostile = HOSTILE.replace("PORT", str(elsewhere.server_port))
    (run / "viewer.html").write_text(hostile)
    page = tab()
    page.goto(f"{server.address}/s/strange")
    body = page.frame_locator(".stage iframe").locator("body[data-got]")
    assert body.get_attribute("data-got") == ""
    frame = next(one for one in page.frames if "/viewer/" in one.url)
    with contextlib.suppress(playwright.Error):  # its context may be gone
        frame.evaluate("() => void (location = url)")
    page.wait_for_timeout(1000)
    assert asked == []
    assert page.url == f"{server.address}/s/strange"
    page.goto(f"{server.address}/viewer/strange")  # on its own it could lead away
    assert page.url == f"{server.address}/" and asked == []
    elsewhere.shutdown()
    shutil.rmtree(run)


NOWHERE = (
    "/api/scene/..%2F..%2Fetc",
    "/api/scene/..",
    "/api/look/.edit3r-app",
    "/api/files/..",
    "/photo/.edit3r-app/0",
    "/pointed/a/0",
    "/candidate/a/1",
    "/static/..%2Fguard.py",
    "/viewer/..",
    "/download/x/..%2Frun.json",
    "/thumbnail/.edit3r-app/0",
    "/overlay/a/0",
    "/image/a/inputs/0",
)


def test_addresses_lead_nowhere_else(server):
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    for address in NOWHERE:
        with pytest.raises(urllib.error.HTTPError) as refused:
            opener.open(server.address + address)
        assert refused.value.code in (400, 404), address
