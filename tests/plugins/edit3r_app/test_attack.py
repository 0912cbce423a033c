"""Strangers at the app's doors: bodies, sentences, and records in the jobs folder."""

import json
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from edit3r_app.jobs import AppJob, JobsFolder
from edit3r_app.objects import read_action
from edit3r_app.runner import Runner
from edit3r_app.server import MAX_ASKED, make_app

from edit3r.cli.main import main
from edit3r.contract.errors import InputError

BODIES = {
    "deep": b"[" * 100_000,
    "deep objects": b'{"say":' * 50_000,
    "half a character": b'{"say": "paint it \\ud800"}',
    "NaN": b'{"value": NaN}',
    "no UTF-8": b'{"say": "\xff\xfe"}',
    "a list": b"[]",
    "a number": b"3",
    "cut off": b'{"say": "pai',
    "too long": b'{"say": "' + b"a" * MAX_ASKED + b'"}',
}


def answer(
    app, body, path="/api/go/x", chunks=1, headers=(), breaks_off=False, method="POST"
):
    """(status, text, how much of the body was read) of a request in chunks, without a length."""
    import asyncio

    sent, size = [], max(1, -(-len(body) // chunks))
    parts = [body[at : at + size] for at in range(0, len(body), size)]
    read = 0

    async def receive():
        nonlocal read
        if not parts and breaks_off:
            return {"type": "http.disconnect"}
        if not parts:
            return {"type": "http.request", "body": b"", "more_body": False}
        part = parts.pop(0)
        read += len(part)
        more = bool(parts) or breaks_off
        return {"type": "http.request", "body": part, "more_body": more}

    async def send(message):
        sent.append(message)

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": b"",
        "headers": [(b"host", b"localhost"), *headers],
        "app": app,
    }
    asyncio.run(app(scope, receive, send))
    return sent[0]["status"], b"".join(one.get("body", b"") for one in sent[1:]), read


def test_an_upload_that_breaks_off_leaves_no_scene_and_raises_nothing(tmp_path):
    app = make_app(JobsFolder(tmp_path), token=None, size=64)
    named = [(b"x-name", b"garden.jpg"), (b"content-length", b"9000")]
    answer(app, b"\xff\xd8\xff" * 1000, "/upload/-", 2, named, breaks_off=True)
    assert not list(tmp_path.glob("garden*")) and JobsFolder(tmp_path).scenes() == []


def test_a_form_of_another_page_is_refused_where_the_browser_names_no_origin(tmp_path):
    app = make_app(JobsFolder(tmp_path), token=None, size=64)
    site = [(b"sec-fetch-site", b"cross-site"), (b"sec-fetch-dest", b"document")]
    assert answer(app, b"{}", "/api/delete/x", headers=site)[0] == 403


def test_a_scene_that_is_not_there_makes_no_folder_and_tells_no_path(tmp_path):
    folder = JobsFolder(tmp_path / "jobs")
    app = make_app(folder, token=None, size=64)
    for kind in ("overlay", "edited", "pointed", "photo"):
        for name in ("nobody", "a" * 5000):
            path = f"/{kind}/{name}/a"
            status, text, _ = answer(app, b"", path, method="GET")
            assert status == 400 and str(tmp_path).encode() not in text
    assert not [path for path in folder.private.iterdir() if path.is_dir()]


def test_two_tabs_that_go_at_once_each_get_their_sentence(tmp_path, monkeypatch):
    folder = JobsFolder(tmp_path)
    scene = folder.new_scene("bear")
    app = make_app(folder, token=None, size=64)
    studio, asked = app.state.studio, []
    meet = threading.Barrier(2, timeout=5)

    def look(state, draft, *_):
        meet.wait()  # both have said their sentence
        asked.append(draft.form["prompt"])
        raise InputError("enough.")

    monkeypatch.setattr(type(studio.previews), "look", staticmethod(look))
    with ThreadPoolExecutor(2) as pool:
        said = [pool.submit(studio.go, scene, "", say) for say in ("gold", "blue")]
    assert all(isinstance(one.exception(), InputError) for one in said)
    assert sorted(asked) == ["blue", "gold"]


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("path", ["/api/go/x", "/api/object/x", "/api/phone"])
def test_a_body_that_is_no_request_is_one_sentence(tmp_path, body, path):
    app = make_app(JobsFolder(tmp_path), token=None, size=64)
    status, text, _ = answer(app, body, path)
    assert status == 400 and b"JSON" in text


def test_an_endless_body_is_cut_off_before_it_is_kept(tmp_path):
    app = make_app(JobsFolder(tmp_path), token=None, size=64)
    status, _, read = answer(app, b"a" * (40 * MAX_ASKED), chunks=400)
    assert status == 400 and read < 1.2 * MAX_ASKED


RECORDS = {
    "an option as the name": {"action": "remove", "name": "--out=/elsewhere"},
    "as the text": {"action": "rename", "name": "bike", "text": "--out=/elsewhere"},
    "as a number": {"action": "scale", "name": "bike", "numbers": ["--overwrite"]},
    "too many": {"action": "remove", "name": "bike", "numbers": [1]},
    "too few": {"action": "rename", "name": "bike"},
    "another action": {"action": "isolate", "name": "bike"},
    "something else": {"action": "remove", "name": "bike", "out": "/elsewhere"},
    "a null": {"action": "remove", "name": "bi\0ke"},
    "a line": {"action": "recolor", "name": "bike", "text": "red\nblue"},
    "half a character": {"action": "remove", "name": "\ud800"},
    "too large": {"action": "turn", "name": "bike", "numbers": [1e9]},
}


@pytest.mark.parametrize("action", RECORDS.values(), ids=RECORDS)
def test_a_strangers_record_asks_for_nothing_but_actions(tmp_path, action):
    folder = JobsFolder(tmp_path)
    (tmp_path / "run").mkdir()
    good = read_action({"action": "remove", "name": "bike"})
    folder.write(AppJob("good", "run", parent="run", object=good, made=1.0))
    record = json.loads((folder.private / "good.json").read_text())
    (folder.private / "bad.json").write_text(
        json.dumps({**record, "name": "bad", "object": action, "made": 0.0})
    )
    assert [job.name for job in folder.jobs()] == ["good"]
    runner = Runner(folder, (sys.executable, "-c", "input()"))
    runner.step()
    assert folder.job("good").state == "running"
    runner.stop()


@pytest.mark.parametrize("name", ["--out=/x", "-h", "a\0b", "a\tb", "\x1b[31m"])
def test_a_name_is_no_option_and_can_be_printed(name):
    with pytest.raises(InputError, match="dash"):
        read_action({"action": "remove", "name": name})


def test_behind_two_dashes_nothing_is_an_option(tmp_path, capsys):
    out = tmp_path / "elsewhere"
    line = f"objects --quiet --out {tmp_path}/o -- {tmp_path}/run rename --out={out} b"
    main(line.split())
    assert not out.exists() and "unrecognized" not in capsys.readouterr().err
    assert json.dumps([path.name for path in tmp_path.iterdir()]) == "[]"
