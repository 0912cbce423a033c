"""The viewer's page in a real browser, drawn by software: what people see, and what they may do."""

import io
import shlex
import shutil

import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.interfaces import NamedObjects, SceneToWrite, SecondLook
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.loading.registry import build

from ..looks import EVERY_LOOK, PHONE, WIDE, cut_off, id_of, serious

playwright = pytest.importorskip(
    "playwright.sync_api", reason="needs playwright: pip install playwright"
)
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
WIDTH, HEIGHT = 320, 240
GO_ON = "go {run} {name} --out {run}-{name}"


def save_viewer(
    path, gaussians, cameras, before=None, looks=("after", "before"), **known
):
    """Write the page; `before` is the second look's colours."""
    if before is not None:
        known["second_look"] = lambda: SecondLook(before, looks)
    scene = SceneToWrite(gaussians, cameras, **known)
    build("writer", "viewer").write(path, scene)


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        CHROMIUM is None, reason="needs the program chromium: apt-get install chromium"
    ),
]


@pytest.fixture(scope="module")
def browser():
    flags = [
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--ignore-gpu-blocklist",
    ]
    with playwright.sync_playwright() as manager:
        yield manager.chromium.launch(executable_path=CHROMIUM, args=flags)


@pytest.fixture(scope="module")
def cameras():
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 0.4
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]]).repeat(
        1, 2, 1, 1
    )
    return Cameras(c2w, intrinsics, (HEIGHT, WIDTH))


@pytest.fixture(scope="module")
def scene():
    """A cloud of small and large Gaussians whose colour changes with the direction."""
    torch.manual_seed(0)
    plain = colour_to_dc(0.35 + 0.3 * torch.rand(1, 600, 1, 3))
    # within [0, 1]: a browser shows no more
    harmonics = torch.cat((plain, 0.1 * torch.randn(1, 600, 15, 3)), 2)
    means = torch.randn(1, 600, 3) * torch.tensor([1.2, 0.9, 0.7]) + torch.tensor(
        [0, 0, 5.0]
    )
    scales = 10 ** (torch.rand(1, 600, 3) - 1.7)
    return Gaussians(
        means, scales, torch.randn(1, 600, 4), torch.rand(1, 600) * 0.8 + 0.2, harmonics
    )


@pytest.fixture
def page(browser, scene, cameras, tmp_path):
    """The page, opened and drawn once; errors on its console fail the test."""
    look = torch.tensor([0.0, 1.0, 0.0]).expand(scene.count, 3)
    save_viewer(
        tmp_path / "v.html",
        scene,
        cameras,
        names=["left", "right"],
        title="a/b: c",
        before=look,
    )
    opened = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    complaints = []
    opened.on("pageerror", lambda error: complaints.append(str(error)))
    opened.on(
        "console",
        lambda message: (
            complaints.append(message.text) if message.type == "error" else None
        ),
    )
    opened.goto((tmp_path / "v.html").as_uri())
    opened.wait_for_selector("body[data-drawn]", timeout=60_000)
    yield opened
    opened.close()
    assert not complaints


def seen(page):
    """What "save picture" saves, as [height, width, 3] in [0, 1]; it is what the canvas shows."""
    with page.expect_download() as download:
        page.keyboard.press("p")
    assert download.value.suggested_filename.startswith("a-b-c-")
    with open(download.value.path(), "rb") as file:
        return np.asarray(Image.open(io.BytesIO(file.read())).convert("RGB")) / 255


def settle(page):
    """Wait until the camera stands still and its picture is drawn."""
    page.wait_for_function("!flight && !dirty")


def drag(page, way, y=HEIGHT / 4):
    page.mouse.move(WIDTH / 2, y)
    page.mouse.down()
    page.mouse.move(WIDTH / 2 + way, y, steps=5)
    page.mouse.up()
    settle(page)


@pytest.mark.parametrize("view", [0, 1])
def test_the_page_shows_what_the_rasterizer_shows(page, scene, cameras, view):
    background = [22 / 255, 22 / 255, 24 / 255]
    rasterizer = build("rasterizer", "torch", background=background)
    expected = (
        rasterizer.render(scene, cameras.select([view]))
        .images[0, 0]
        .clamp(0, 1)
        .permute(1, 2, 0)
        .numpy()
    )
    page.keyboard.press(str(view + 1))
    settle(page)
    error = np.square(seen(page) - expected).mean()
    assert -10 * np.log10(error) > 32, (
        "the centres, ellipses, order or harmonics differ"
    )


def test_t_turns_photos_that_lie_on_their_side(page, scene, cameras):
    upright = seen(page)
    up, across = page.evaluate("[meta.up, pose.r[0]]")
    page.keyboard.press("t")
    page.wait_for_function("location.hash === '#turn=1' && document.body.dataset.drawn")
    settle(page)
    assert page.evaluate("meta.up") == pytest.approx([-x for x in across], abs=1e-6)
    assert page.evaluate("pose.r[0]") == pytest.approx(up, abs=1e-6)
    share = HEIGHT / WIDTH  # the photo's long side is now as high as the window
    small = Image.fromarray(np.uint8(255 * np.rot90(upright, -1))).resize(
        (round(HEIGHT * share), HEIGHT)
    )
    left = (WIDTH - small.width) // 2
    shown = seen(page)[:, left : left + small.width]
    error = np.square(shown - np.asarray(small) / 255).mean()
    assert -10 * np.log10(error) > 25
    page.keyboard.press("r")
    settle(page)
    assert page.evaluate("pose.r[0]") == pytest.approx(up, abs=1e-6)


def test_the_switch_shows_the_look_before_and_keeps_the_camera(page):
    drag(page, 20)
    pose = page.evaluate("JSON.stringify(pose)")
    after = seen(page)
    page.click("#switch")
    settle(page)
    before = seen(page)
    assert (
        before[..., 1].sum() > 1.2 * after[..., 1].sum()
        and before[..., 0].sum() < 0.9 * after[..., 0].sum()
    )
    page.keyboard.press("b")
    settle(page)
    np.testing.assert_array_equal(seen(page), after)
    assert page.evaluate("JSON.stringify(pose)") == pose


COUNTED = """() => {
  window.drawn = 0;
  const own = requestAnimationFrame;
  window.requestAnimationFrame = (then) => own((now) => { drawn++; then(now); });
}"""


def test_a_picture_that_stands_still_is_not_drawn_anew(page):
    def drawn(act):
        settle(page)
        page.wait_for_timeout(300)
        page.evaluate("drawn = 0")
        act()
        page.wait_for_timeout(300)
        settle(page)
        return page.evaluate("drawn")

    page.evaluate(COUNTED)
    assert drawn(lambda: None) == 0
    assert drawn(lambda: page.keyboard.press("ArrowRight")) == 1
    assert drawn(lambda: page.keyboard.press("2")) > 2  # a flight
    assert drawn(lambda: page.keyboard.press("b")) == 1
    assert drawn(lambda: page.keyboard.press("w")) >= 1
    wider = {"width": WIDTH + 40, "height": HEIGHT}
    assert drawn(lambda: page.set_viewport_size(wider)) >= 1
    assert page.evaluate("canvas.width") == WIDTH + 40
    assert drawn(lambda: None) == 0


def test_a_handle_divides_the_picture_between_both_looks(page):
    after = seen(page)
    page.click("#switch")
    before = seen(page)
    page.keyboard.press("c")
    page.locator("#cut").press("ArrowLeft")  # to 45 %
    settle(page)
    both, column = seen(page), round(0.45 * WIDTH)
    np.testing.assert_array_equal(both[:, :column], before[:, :column])
    np.testing.assert_array_equal(both[:, column:], after[:, column:])


def test_a_second_look_has_its_name_and_one_colour_from_all_sides(
    browser, scene, cameras, tmp_path
):
    grey = torch.full((scene.count, 3), 0.5)
    save_viewer(
        tmp_path / "v.html",
        scene,
        cameras,
        title="a/b: c",
        before=grey,
        looks=("scene", "uncertainty"),
    )
    opened = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    opened.goto((tmp_path / "v.html").as_uri())
    opened.wait_for_selector("body[data-drawn]", timeout=60_000)
    assert opened.text_content("#switch") == "uncertainty"
    opened.click("#switch")
    settle(opened)
    assert opened.text_content("#switch") == "scene"
    image = seen(opened)
    assert 0.4 < image.max() < 0.6 and np.ptp(image, axis=2).max() < 0.02
    opened.close()


def test_turning_ends_where_no_photo_shows_the_scene_and_fades_on_the_way(page):
    drag(page, 15)
    near, clear = (
        page.evaluate("away(pose.t)"),
        float(page.evaluate("canvas.style.opacity")),
    )
    for _ in range(4):
        drag(page, 150)
    far, faded = (
        page.evaluate("away(pose.t)"),
        float(page.evaluate("canvas.style.opacity")),
    )
    assert 0 < near < far <= page.evaluate("FARTHEST") + 1e-6
    assert (
        clear > 0.9
        and faded < 0.7
        and page.evaluate("element('beyond').style.opacity") == "1"
    )
    page.click("text=right")
    settle(page)
    assert page.evaluate("away(pose.t)") < 1e-6 and page.evaluate(
        "pose.t[0]"
    ) == pytest.approx(0.4)


def test_the_wheel_enlarges_what_is_under_it_and_leaves_the_camera(page):
    pose = page.evaluate("JSON.stringify(pose)")
    page.mouse.move(80, 60)
    spot = (
        "(({ principal: c, focal: f }) => "
        "[(80 - c[0]) / f[0], (60 - c[1]) / f[1]])(pixels(lens))"
    )
    before = page.evaluate(spot)
    for _ in range(3):
        page.mouse.wheel(0, -100)
    page.wait_for_function("zoom > 1.3")
    assert page.evaluate(spot) == pytest.approx(before, abs=1e-9)
    assert page.evaluate("JSON.stringify(pose)") == pose


def test_two_fingers_enlarge_and_one_turns(browser, scene, cameras, tmp_path):
    save_viewer(tmp_path / "v.html", scene, cameras)
    context = browser.new_context(
        viewport={"width": WIDTH, "height": HEIGHT}, has_touch=True
    )
    page = context.new_page()
    page.goto((tmp_path / "v.html").as_uri())
    page.wait_for_selector("body[data-drawn]", timeout=60_000)
    touch = context.new_cdp_session(page)

    def fingers(kind, *points):
        points = [{"x": x, "y": y, "id": index} for index, (x, y) in enumerate(points)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", (120, 70))
    fingers("touchMove", (150, 70))
    fingers("touchEnd")
    assert page.evaluate("away(pose.t)") > 0 and page.evaluate("zoom") == 1
    fingers("touchStart", (120, 70), (160, 70))
    fingers("touchMove", (100, 70), (180, 70))
    fingers("touchEnd")
    assert page.evaluate("zoom") == pytest.approx(2, rel=0.2)
    context.close()


@pytest.fixture(scope="module")
def balls():
    """A red ball in the middle before a green wall; half of the wall is unsure."""
    torch.manual_seed(0)
    ball = 0.25 * torch.nn.functional.normalize(torch.randn(100, 3), dim=1)
    places = torch.linspace(-2, 2, 20)
    wall = torch.cartesian_prod(places, places, torch.ones(1))
    means = torch.cat((ball, wall)) + torch.tensor([0, 0, 3.0])
    colours = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.9, 0.1]])
    is_wall = torch.arange(500) >= 100
    return Gaussians(
        means=means[None],
        scales=torch.where(is_wall, 0.15, 0.1)[None, :, None].expand(1, 500, 3),
        quats=torch.tensor([1.0, 0, 0, 0]).expand(1, 500, 4),
        opacities=torch.full((1, 500), 0.9),
        harmonics=colour_to_dc(colours[is_wall.int()])[None, :, None],
        object_index=torch.where(is_wall, -1, 7),
        uncertainty=(0.8 * (is_wall & (means[:, 0] > 0)))[None],
    )


@pytest.fixture
def opened(browser, balls, cameras, tmp_path):
    """Opens the page of the ball, on a screen with or without touch."""
    save_viewer(
        tmp_path / "v.html",
        balls,
        cameras,
        title="a/b: c",
        objects=NamedObjects({"other": 3, "the ball's": 7}, GO_ON),
    )

    def one(**screen):
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, **screen)
        page.goto((tmp_path / "v.html").as_uri())
        page.wait_for_selector("body[data-drawn]", timeout=60_000)
        pages.append(page)
        return page

    pages = []
    yield one
    for page in pages:
        page.close()


def middle(page):
    """Mean colour in the middle of the image."""
    settle(page)
    rows, columns = HEIGHT // 2, WIDTH // 2
    return seen(page)[rows - 5 : rows + 5, columns - 5 : columns + 5].mean((0, 1))


def test_a_click_chooses_the_object_in_front_to_hide_it_or_all_else(opened, tmp_path):
    page = opened()
    red, green, _ = middle(page)
    assert red > 0.8 and green < 0.2
    page.mouse.click(WIDTH / 2, HEIGHT / 2)
    assert page.text_content("#names [aria-pressed=true]") == "the ball's"
    marked = middle(page)
    assert marked[1] > green + 0.1
    folder = tmp_path.as_posix()
    quoted = "the ball'\\''s"
    line = f"go {folder} '{quoted}' --out '{folder}-{quoted}'"
    assert page.text_content("#command") == line
    assert shlex.split(line)[2] == "the ball's"
    page.click("#hide")
    red, green, _ = middle(page)
    assert red < 0.2 and green > 0.8
    page.click("#hide")
    np.testing.assert_array_equal(middle(page), marked)
    page.click("#only")
    settle(page)
    assert seen(page)[:10].max() < 0.1  # no wall
    page.click("#all")
    page.set_viewport_size({"width": 2 * WIDTH, "height": 2 * HEIGHT})
    settle(page)
    page.mouse.click(WIDTH, HEIGHT / 2)  # the wall is no object
    settle(page)
    assert page.locator("#names [aria-pressed=true]").count() == 0
    assert not page.is_visible("#hide") and seen(page)[:10, :, 1].max() > 0.8


def test_a_drag_chooses_nothing_and_a_tap_does(opened):
    page = opened(has_touch=True)
    drag(page, 10, HEIGHT / 2)
    assert page.evaluate("chosen") == 0
    assert page.evaluate("pick(innerWidth / 2 + 10, innerHeight / 2)") == 2
    page.keyboard.press("r")
    settle(page)
    page.touchscreen.tap(WIDTH / 2, HEIGHT / 2)
    assert page.evaluate("chosen") == 2


def test_the_slider_hides_what_is_less_sure_and_nothing_at_one(opened):
    page = opened()
    whole = seen(page)
    page.fill("#sureness input", "0.5")
    settle(page)
    part = seen(page)
    assert part[:, -60:, 1].max() < 0.1
    np.testing.assert_array_equal(part[:, :60], whole[:, :60])
    page.fill("#sureness input", "1")
    settle(page)
    np.testing.assert_array_equal(seen(page), whole)


STROKE = """(keys) => ["keydown", "keyup"].forEach(
    (kind) => dispatchEvent(new KeyboardEvent(kind, keys)))"""


def test_keys_fly_faster_with_shift_and_no_farther_than_the_photos_show(page):
    begin = seen(page)
    for key, axis, sign in (("w", 2, 1), ("a", 0, -1), ("e", 1, -1)):
        page.evaluate(STROKE, {"key": key})
        settle(page)
        step = page.evaluate("pose.t")[axis] * sign
        assert step > 0
        page.evaluate(STROKE, {"key": key.upper(), "shiftKey": True})
        assert page.evaluate("pose.t")[axis] * sign == pytest.approx(5 * step)
        settle(page)
        assert key != "w" or not np.array_equal(seen(page), begin)
        page.keyboard.press("r")
        settle(page)
        assert page.evaluate("pose.t") == [0, 0, 0]
    page.keyboard.down("e")
    page.wait_for_function("away(pose.t) > 0.9 * FARTHEST")
    page.wait_for_timeout(500)  # in which it would fly half as far again
    page.keyboard.up("e")
    assert page.evaluate("away(pose.t)") <= page.evaluate("FARTHEST") + 1e-6


AROUND = """<body style="margin: 0"><iframe src="v.html?embed" style="border: 0; width: 100vw;
height: 100vh"></iframe><script>heard = []; addEventListener("message", (e) =>
heard.push(e.data.edit3r)); tell = (message) => frames[0].postMessage({edit3r: message}, "*");
</script>"""


def test_inside_of_the_app_a_click_points_and_handles_ask_for_the_object(
    opened, tmp_path
):
    page = opened()
    (tmp_path / "around.html").write_text(AROUND)
    page.goto((tmp_path / "around.html").as_uri())
    inner = page.frame_locator("iframe")
    inner.locator("body[data-drawn]").wait_for()

    def heard(key):
        page.wait_for_function(f"heard.some((one) => one.{key} !== undefined)")
        return page.evaluate(f"heard.findLast((one) => one.{key} !== undefined)")[key]

    page.evaluate("tell({pointing: true})")
    inner.locator("body.pointing").wait_for()
    page.mouse.click(WIDTH / 2, HEIGHT / 2)
    hit = heard("pointed")
    assert hit["name"] == "view 0"
    assert hit["places"] == [pytest.approx([0.5, 0.5], abs=0.01)]
    inner.locator("#heard circle").wait_for()  # it was heard
    # what the photo's mask holds is tinted: its left half, so about half of all
    one = "{name: 'view 0', width: 2, height: 1, inside: Uint8Array.of(1, 0)}"
    page.evaluate(f"tell({{selected: [{one}]}})")
    share = inner.locator("body[data-marked]").get_attribute("data-marked")
    count = page.frames[1].evaluate("meta.count")
    assert 0.3 * count < int(share) < 0.7 * count
    inner.locator("#heard").wait_for(state="hidden")
    # where the mouse rests, what a click would take is tinted, and no longer when it goes on
    page.mouse.move(0.7 * WIDTH, HEIGHT / 2)
    assert heard("rests")["places"][0][0] == pytest.approx(0.7, abs=0.01)
    other = one.replace("(1, 0)", "(0, 1)")
    page.evaluate(f"tell({{meant: {other}}})")
    more = int(inner.locator("body[data-meant]").get_attribute("data-meant"))
    assert more > int(share)
    page.mouse.move(0.6 * WIDTH, HEIGHT / 2)
    page.evaluate(f"tell({{meant: {other}}})")  # an answer that comes late
    marked = page.frames[1].evaluate("marked.reduce((sum, one) => sum + one, 0)")
    assert marked == int(share)
    # a press that lasts, as on a slow machine, and is then dragged turns: it marks nothing
    before = page.frames[1].evaluate("pose.t")
    page.evaluate("heard.length = 0")
    page.mouse.down()
    page.wait_for_timeout(600)
    page.mouse.move(0.65 * WIDTH, 0.52 * HEIGHT, steps=2)
    page.mouse.up()
    assert not page.evaluate("heard.some((one) => one.pointed)")
    assert page.frames[1].evaluate("pose.t") != before
    page.evaluate("tell({view: 0})")
    page.frames[1].wait_for_function("pose === views[0].pose")
    page.mouse.move(0.6 * WIDTH, HEIGHT / 2)
    # with Alt a line is drawn and the camera stays
    page.evaluate("heard.length = 0")
    page.keyboard.down("Alt")
    page.mouse.down()
    page.mouse.move(0.4 * WIDTH, HEIGHT / 2, steps=5)
    page.mouse.up()
    page.keyboard.up("Alt")
    line = heard("pointed")["places"]
    assert len(line) > 3 and line[0][0] > 0.55 and line[-1][0] < 0.45
    assert page.frames[1].evaluate("pose.t") == [0, 0, 0]
    for harmless in ("{name: 'none', width: 1, height: 1, inside: 1}", "null"):
        page.evaluate(f"try {{ tell({{selected: [{harmless}]}}) }} catch {{}}")

    page.evaluate("heard.length = 0; tell({pointing: false})")
    inner.locator("body:not(.pointing)").wait_for()
    page.mouse.click(WIDTH / 2, HEIGHT / 2)
    assert heard("chosen") == "the ball's"
    page.mouse.move(WIDTH / 2, HEIGHT / 2)
    page.mouse.down()
    page.mouse.move(WIDTH / 2 + 30, HEIGHT / 2, steps=3)
    page.mouse.up()
    asked = heard("object")
    assert (asked["action"], asked["name"]) == ("move", "the ball's")
    right, up, nearer = asked["numbers"]
    assert right > 0.05 and abs(up) < 0.01 and abs(nearer) < 0.01
    inner.get_by_label("scale; arrow keys").press("ArrowUp")
    page.wait_for_function("heard.some((one) => one.object?.action === 'scale')")
    assert heard("object")["numbers"][0] > 1


LYING_OVER = """() => {
  const names = "header h1, #map, #cut span, footer button, #help, #beyond";
  const shown = [...document.querySelectorAll(names)]
    .filter((one) => one.checkVisibility({opacityProperty: true}))
    .map((one) => [one.id || one.textContent, one.getBoundingClientRect()]);
  const over = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
    && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
  const outside = shown.filter(([, a]) => a.left < 0 || a.top < 0
    || a.right > innerWidth || a.bottom > innerHeight).map(([name]) => name);
  return [...outside, ...shown.flatMap(([name, a], k) => shown.slice(k + 1)
    .filter(([, b]) => over(a, b)).map(([other]) => `${name} over ${other}`))];
}"""


MESSAGES = (
    "header h1",
    "header p",
    "#beyond",
    "#help",
    "#cut span",
    "#command",
    "#sureness",
    "#problem",
    "footer > button",
)
"""Elements that hold sentences."""
LONG = "the red motorcycle with its helmet on the handlebar, beside the shelf"


def looked_at(page, look):
    """The page opened anew in one of the looks."""
    (width, height), theme = look
    page.emulate_media(color_scheme=theme)
    page.set_viewport_size({"width": width, "height": height})
    page.reload()
    page.wait_for_selector("body[data-drawn]", timeout=60_000)


def all_can_be_read(page):
    assert page.evaluate(LYING_OVER) == []
    assert cut_off(page, MESSAGES) == []
    # a name that is too long for its button is read where the mouse rests
    hides = """[...document.querySelectorAll("button")].filter((one) => one.checkVisibility()
      && one.scrollWidth > one.clientWidth + 1 && !one.title.includes(one.textContent))"""
    assert page.evaluate(f"{hides}.map((one) => one.textContent)") == []
    assert serious(page) == []


@pytest.mark.parametrize("look", EVERY_LOOK, ids=id_of)
def test_a_strangers_first_look(page, look):
    """Nothing lies over anything else, help opens and closes, and a phone's window is filled."""
    looked_at(page, look)
    page.keyboard.press("c")
    all_can_be_read(page)
    filled = "zoom * Math.min(canvas.width / lens.width, canvas.height / lens.height)"
    assert page.evaluate(f"{filled} * lens.height / canvas.height") > 0.5
    page.keyboard.press("c")  # the handle goes: the help lies over it on phones
    page.keyboard.press("?")
    assert page.get_by_text("fly to a photo").is_visible()
    all_can_be_read(page)
    page.keyboard.press("Escape")
    assert page.get_by_text("fly to a photo").is_hidden()
    page.get_by_role("button", name="help").click()
    assert page.get_by_text("fly to a photo").is_visible()
    page.get_by_role("button", name="help").click()
    for _ in range(80):
        page.keyboard.press("ArrowRight")
    page.wait_for_function("element('beyond').style.opacity === '1'")
    told = page.get_by_text("No photo shows the scene from here.")
    ground = told.evaluate("(one) => getComputedStyle(one).backgroundColor")
    assert told.is_visible() and ground.startswith("rgba(22, 22, 24, 0.9")
    all_can_be_read(page)


@pytest.mark.parametrize("look", EVERY_LOOK, ids=id_of)
def test_a_scene_with_objects_and_long_names_can_be_read(
    browser, balls, cameras, tmp_path, look
):
    names = NamedObjects({LONG: 7, "other": 3}, GO_ON)
    photos = [f"{LONG}, left.jpg", "right.jpg"]
    save_viewer(
        tmp_path / "v.html", balls, cameras, title=LONG, names=photos, objects=names
    )
    page = browser.new_page()
    page.goto((tmp_path / "v.html").as_uri())
    looked_at(page, look)
    all_can_be_read(page)
    page.locator("#names button").first.press("Enter")
    page.locator("#command").wait_for()
    all_can_be_read(page)
    page.locator("#hide").press("Enter")
    page.get_by_text("show all").wait_for()
    all_can_be_read(page)
    page.close()


@pytest.mark.parametrize(
    ("look", "unit"), [(WIDE, ""), (PHONE, "m")], ids=["wide", "phone"]
)
def test_two_clicks_measure_and_escape_ends_it(browser, cameras, tmp_path, look, unit):
    """A wall 2 ahead of the camera: the length is that of the places, wherever it is seen from."""
    y, x = torch.meshgrid(
        torch.linspace(-2, 2, 60), torch.linspace(-2, 2, 60), indexing="ij"
    )
    means = torch.stack((x, y, torch.full_like(x, 2)), -1).reshape(1, -1, 3)
    count = means.shape[1]
    wall = Gaussians(
        means,
        torch.tensor([0.06, 0.06, 0.001]).expand(1, count, 3),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.full((1, count), 0.9),
        colour_to_dc(torch.rand(1, count, 1, 3)),
    )
    save_viewer(tmp_path / "v.html", wall, cameras, unit=unit)
    page = browser.new_page(viewport={"width": look[0], "height": look[1]})
    page.goto((tmp_path / "v.html").as_uri())
    page.wait_for_selector("body[data-drawn]", timeout=60_000)
    page.get_by_role("button", name="measure").click()
    told = page.locator("#length")
    page.wait_for_function("!told.hidden")  # it is written when the next frame is drawn
    assert told.inner_text() == "click two places of the scene"
    at = page.evaluate(
        """() => {
          const {focal, principal} = pixels(lens), s = canvas.width / canvas.clientWidth;
          const at = (x) => [(focal[0] * x / 2 + principal[0]) / s, principal[1] / s];
          return [at(-0.2), at(0.2)];
        }"""
    )
    for place in at:
        page.mouse.click(*place)
    page.wait_for_function("!told.textContent.startsWith('click')")
    assert page.locator("#ruler").is_visible()
    length, _, shown = told.inner_text().partition(" ")
    assert float(length) == pytest.approx(0.4, rel=0.01)
    assert shown == (unit or "units")
    ends = "[...ruler.children[0].attributes].map((one) => Number(one.value))"
    assert page.evaluate(ends) == pytest.approx([*at[0], *at[1]], abs=1)
    assert cut_off(page, ["#length"]) == [] and serious(page) == []
    page.keyboard.press("+")  # the line stays at its places
    page.wait_for_function(f"Math.abs({ends}[0] - {at[0][0]}) > 1")
    assert float(told.inner_text().split()[0]) == float(length)
    page.keyboard.press("Escape")
    page.wait_for_function("element('ruler').hasAttribute('hidden')")
    assert told.is_hidden() and page.locator("body.measuring").count() == 0
    page.close()


@pytest.mark.parametrize("kind", ["lasso", "brush"])
def test_a_stroke_is_told_with_the_camera_that_it_was_drawn_from(page, kind):
    places = [[80, 60], [240, 60], [240, 180], [80, 180]]
    told = page.evaluate(f"drawing = '{kind}', drawn({places})")
    assert told["kind"] == kind and told["aspect"] == pytest.approx(WIDTH / HEIGHT)
    assert told["places"][0] == [0.25, 0.25]
    assert told["lens"] == pytest.approx([0.9, 1.2, 0.5, 0.5])
    assert told["right"] == [1, 0, 0] and told["centre"] == [0, 0, 0]


def test_what_was_chosen_is_tinted_and_hidden(page, scene):
    bits = np.packbits(np.ones(scene.count, np.uint8)).tobytes().hex()
    page.evaluate(f"choosePicked('{bits}')")
    assert page.evaluate("document.body.dataset.picked") == str(scene.count)
    before = seen(page)
    page.evaluate("gone = true, redraw()")
    assert seen(page).max() < before.max() / 2, "nothing is left to see"
    page.evaluate("choosePicked('')")
    assert seen(page).max() > before.max() / 2
