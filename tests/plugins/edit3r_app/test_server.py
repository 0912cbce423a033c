"""Each address asks the right part for what it names, and sends back its answer."""

import io
import json

import pytest
from edit3r_app.draft import Draft, Mark, write_draft
from edit3r_app.jobs import JobsFolder
from edit3r_app.server import SANDBOX, THUMBNAIL, Answers, refused
from PIL import Image

pytest.importorskip("httpx2", reason="Starlette's client needs it")
from starlette.applications import Starlette
from starlette.testclient import TestClient

from edit3r.contract.errors import Edit3rError


class Asked:
    """A part of the app that keeps what it is asked, and answers with `answer`."""

    def __init__(self, answer=None, **parts):
        self.answer, self.calls = answer, []
        vars(self).update(parts)

    def __getattr__(self, name):
        def call(*given, **more):
            self.calls.append((name, *given, *more.items()))
            return self.answer

        return call


@pytest.fixture
def folder(tmp_path):
    folder = JobsFolder(tmp_path / "jobs")
    scene = folder.path(folder.new_scene("garden"))
    Image.new("RGB", (640, 400), "red").save(scene / "images" / "a.png")
    return folder


@pytest.fixture
def studio(folder):
    parts = {"runner": Asked(), "previews": Asked(b"picture")}
    return Asked({"done": 1}, folder=folder, **parts)


@pytest.fixture
def client(studio):
    answers = Answers(studio, ("localhost", 9), None, "/below")
    refusals = {Edit3rError: refused, OSError: refused}
    app = Starlette(routes=answers.below_root(), exception_handlers=refusals)
    return TestClient(app, follow_redirects=False)


@pytest.mark.parametrize(
    ("path", "body", "call"),
    [
        ("step/garden", {"value": 1}, ("step", "garden", 1)),
        ("step/garden", {"value": 2}, ("step", "garden", -1)),
        ("step/garden", {}, ("step", "garden", -1)),
        ("go/garden", {"at": "r", "say": "x"}, ("go", "garden", "r", "x")),
        ("go/garden", {}, ("go", "garden", "", "")),
        ("object/garden", {"at": "r", "do": 2}, ("act", "garden", "r", {"do": 2})),
        ("upright/garden", {"up": "z"}, ("turn_upright", "garden", "z")),
        ("remove/garden", {"photo": "a"}, ("take_out", "garden", "a")),
        ("delete/garden", {}, ("delete", "garden")),
        ("made/tree", {}, ("made", "tree")),
        ("draft/garden", {"words": "x"}, ("change", "garden", {"words": "x"})),
        ("draw/run", {"as": "y"}, ("draw", "run", {"as": "y"})),
        ("scene/garden?at=r", None, ("scene", "garden", "r")),
        ("scene/garden", None, ("scene", "garden", "")),
        ("look/garden", None, ("look", "garden")),
        ("suggestions/garden/a.png", None, ("suggestions", "garden", "a.png")),
        ("verdict/run", None, ("verdict", "run")),
        ("settings/run", None, ("settings", "run")),
        ("files/run", None, ("files", "run")),
    ],
)
@pytest.mark.parametrize("root", ["", "/below"])
def test_questions_and_wishes_reach_the_studio(client, studio, path, body, call, root):
    address = f"{root}/api/{path}"
    got = client.get(address) if body is None else client.post(address, json=body)
    assert studio.calls == [call]
    assert got.json() in ({"done": 1}, None)


def test_a_run_is_cancelled_by_its_name(client, studio):
    client.post("/api/cancel/garden-2")
    assert studio.runner.calls == [("cancel", "garden-2")]


MARKED = Draft(marks=[Mark("add", "a.png", [(0.25, 0.75)])])
STROKE = json.dumps({"kind": "stroke", "photo": "a.png", "places": [[0.1, 0.2]]})


@pytest.mark.parametrize(
    ("path", "call", "kind"),
    [
        ("photo/garden/a.png", ("photo", "garden", "a.png", False), "jpeg"),
        ("photo/garden/a.png?shown", ("photo", "garden", "a.png", True), "jpeg"),
        ("overlay/garden/a.png", ("overlay", "garden", 1, "a.png", False), "png"),
        ("overlay/garden/a.png?line", ("overlay", "garden", 1, "a.png", True), "png"),
        ("edited/garden/a.png", ("edited", "garden", 1, "a.png", False), "jpeg"),
        ("edited/garden/a.png?found", ("edited", "garden", 1, "a.png", True), "jpeg"),
        ("suggestion/garden/a.png/3", ("suggestion", "garden", "a.png", 3), "jpeg"),
        ("candidate/garden/2", ("candidate", "garden", 1, 2), "jpeg"),
        ("pointed/garden/a.png", ("pointed", "garden", 1, "a.png"), "png"),
    ],
)
def test_pictures_are_of_the_state_and_the_draft_as_it_is(
    client, studio, folder, path, call, kind
):
    """The draft, which has one mark, stands as its number of marks."""
    write_draft(folder, "garden", MARKED)
    got = client.get(f"/{path}")
    assert got.content == b"picture" and got.headers["content-type"] == f"image/{kind}"
    (asked,) = studio.previews.calls
    plain = [len(one.marks) if isinstance(one, Draft) else one for one in asked]
    assert tuple(plain[: len(call)]) == call
    gone = client.get(f"/{path.replace('garden', 'meadow')}")
    assert gone.status_code == 400 and "meadow" in gone.text
    assert len(studio.previews.calls) == 1


@pytest.mark.parametrize(
    ("query", "kept", "marks", "line"),
    [
        ({}, [], 0, False),
        ({"line": ""}, [], 0, True),
        ({"mark": STROKE}, [], 1, True),
        ({"mark": STROKE, "made": ""}, [], 1, False),
        ({"mark": STROKE, "made": ""}, [Mark("stroke", "a.png", [(0.1, 0.2)])], 1, 0),
        ({"mark": STROKE}, [Mark("stroke", "a.png", [(0.1, 0.2)])], 2, True),
    ],
)
def test_a_mark_that_is_being_made_is_shown_once(
    client, studio, folder, query, kept, marks, line
):
    write_draft(folder, "garden", Draft(marks=kept))
    client.get("/pointed/garden/a.png", params=query)
    ((_, _, draft, _, shown),) = studio.previews.calls
    assert (len(draft.marks), shown) == (marks, ("line", bool(line)))


def test_thumbnails_keep_the_shape_and_are_of_photos_that_are_there(client):
    got = client.get("/thumbnail/garden/a")
    assert got.headers["content-type"] == "image/jpeg"
    with Image.open(io.BytesIO(got.content)) as small:
        assert small.size == (THUMBNAIL, THUMBNAIL * 400 // 640)
    assert client.get("/thumbnail/garden/b").status_code == 400


def test_the_page_of_a_stranger_is_shown_in_a_frame_of_its_own_only(
    client, studio, tmp_path
):
    page = tmp_path / "viewer.html"
    page.write_text("scene")
    studio.previews.answer = page
    alone = client.get("/viewer/garden", headers={"sec-fetch-dest": "document"})
    assert (alone.status_code, alone.headers["location"]) == (303, "/below/")
    framed = client.get("/viewer/garden", headers={"sec-fetch-dest": "iframe"})
    assert framed.text == "scene"
    assert framed.headers["content-security-policy"] == SANDBOX
    assert '"/below/static/' in client.get("/s/garden").text
