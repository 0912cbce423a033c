"""The tools as an assistant calls them: through the protocol, with the official client."""

import base64
import contextlib
import io
import json
import os
import shutil
import sys
from pathlib import Path

import anyio
import pytest
from PIL import Image

from edit3r.cli.main import main
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import save_ply
from tests.plugins.scan import scan

pytest.importorskip("mcp", reason='needs the server: pip install "edit3r[mcp]"')
from edit3r_mcp import tools
from edit3r_mcp.tools import server
from mcp import Client, StdioServerParameters

pytestmark = pytest.mark.slow

QUICK = """
size: 64
gaussians: all
refine: 0
frames: 2
outputs: [scene, images, sheet]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("place")
    (place / "quick.yaml").write_text(QUICK)
    (place / "work").mkdir()
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((96, 64)).save(place / "work" / f"{name}.png")
    return place


async def in_this_process(command, out, error, context):
    """What a command would have answered in a process of its own, without its imports."""
    said, wrong = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(wrong):
        code = main(command[command.index("edit3r") + 1 :])
    out.write_text(said.getvalue())
    error.write_text(wrong.getvalue())
    return code


@pytest.fixture(scope="module")
def call_a_process(place):
    """Call one tool: (its text, its image or None, whether it is an error)."""

    async def asked(name, arguments):
        made = server(place / "work", str(place / "quick.yaml"), 600)
        async with Client(made) as client:
            return await client.call_tool(name, arguments)

    def call(name, **arguments):
        answer = anyio.run(asked, name, arguments)
        image = None
        for content in answer.content[1:]:
            image = Image.open(io.BytesIO(base64.b64decode(content.data)))
        return answer.content[0].text, image, answer.is_error

    return call


@pytest.fixture
def call(call_a_process, monkeypatch):
    """The same, but that commands run in this process."""
    monkeypatch.setattr(tools, "ended", in_this_process)
    return call_a_process


@pytest.fixture(scope="module")
def edited(call_a_process):
    """The answer of the one edit that all tests share."""
    return call_a_process("edit", prompt="make it warmer", photos=["a.png", "b.png"])


def test_a_selection_is_shown_on_every_photo(call, place):
    marks = {"points": ["0.5,0.5"]}
    text, image, failed = call("select", photos=["a.png", "b.png"], marks=marks)
    assert not failed and "a: marked" in text
    with Image.open(place / "work" / "selection-1" / "preview.png") as preview:
        assert image.size == preview.size and image.width == 2 * 96


def test_an_edit_answers_with_its_verdicts_and_its_sheet(edited, place):
    text, image, failed = edited
    assert not failed
    assert [line.partition(":")[0] for line in text.splitlines()] == [
        "run",
        "edit",
        "scene",
    ]
    assert image.format == "JPEG" and min(image.size) > 64
    assert (place / "work" / "edit-1" / "scene.ply").is_file()


def test_a_run_is_looked_at_again_and_edited_again(edited, call, place):
    assert call("look", run="edit-1")[0] == edited[0]
    text, _, failed = call("edit", prompt="make it colder", earlier="edit-1")
    assert not failed and text.startswith("run: edit-2")


def test_a_known_length_and_level_places_are_told(edited, call, place):
    known = {"measure": "0.3,0.5,0.6,0.6=2m", "up": "0.3,0.9,0.7,0.95,0.5,0.8"}
    text, _, failed = call(
        "edit", prompt="make it colder", photos=["a.png", "b.png"], **known
    )
    assert not failed
    run = text.split()[1]
    about = json.loads((place / "work" / run / "run.json").read_text())
    assert about["frame"].startswith("turned") and about["frame"].endswith("in metres")


@pytest.mark.parametrize(
    ("form", "made"),
    [("ply", ".ply"), ("colmap", "-colmap"), ("viewer", "-viewer.html")],
)
def test_a_run_is_exported_beside_it(edited, call, place, form, made):
    text, _, failed = call("export", run="edit-1", form=form)
    out = place / "work" / f"edit-1{made}"
    assert not failed and out.exists() and str(out) in text


def test_an_export_replaces_no_file(edited, call, place):
    mine = place / "work" / "edit-1.glb"
    mine.write_text("mine")
    text, _, failed = call("export", run="edit-1", form="glb")
    assert not failed and "edit-1-1.glb" in text and mine.read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "arguments", "told"),
    [
        ("edit", {"prompt": "x", "photos": ["c.png"]}, "no such file or folder"),
        ("edit", {"prompt": "make it warmer"}, "Give photos, or the name"),
        ("look", {"run": "../place"}, "is no run; there are: edit-1"),
        ("edit", {"prompt": "x", "earlier": "/etc"}, "'/etc' is no run"),
        (
            "export",
            {"run": "edit-1", "form": "exe"},
            "'exe': no form; there are colmap",
        ),
        ("select", {"photos": ["a.png"], "marks": {"points": ["9"]}}, "expected X,Y"),
        (
            "edit",
            {"prompt": "warmer", "earlier": "edit-1", "up": "+z"},
            "photos have no axes",
        ),
        (
            "edit",
            {"prompt": "warmer", "earlier": "edit-1", "measure": "9,9=2"},
            "expected [N:]X,Y,[N:]X,Y=LENGTH",
        ),
    ],
)
def test_an_error_is_one_sentence(edited, call, name, arguments, told):
    text, image, failed = call(name, **arguments)
    assert failed and told in text and image is None and "\n" not in text


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("run.json", b"[]"),
        ("run.json", b"\xff"),
        ("run.json", b'{"verdict": 1}'),
        ("before_after.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"),
    ],
)
def test_a_strangers_run_is_refused_in_one_sentence(edited, call, place, file, content):
    shutil.copytree(place / "work" / "edit-1", place / "work" / "strange")
    (place / "work" / "strange" / file).write_bytes(content)
    text, _, failed = call("look", run="strange")
    shutil.rmtree(place / "work" / "strange")
    assert failed and "is damaged" in text and "\n" not in text
    assert file == "run.json" or "not an image" in text


def test_a_word_that_no_program_takes_is_one_sentence(call_a_process):
    text, _, failed = call_a_process("edit", prompt="a\0b", photos=["a.png", "b.png"])
    assert failed and "cannot be passed on" in text


def test_links_lead_nothing_out_of_the_folder(edited, call, place):
    for name in ("edit-1.ply", "selection-2"):
        (place / "work" / name).unlink(missing_ok=True)
        (place / "work" / name).symlink_to(place / "outside")
    assert not call("export", run="edit-1", form="ply")[2]
    marks = {"points": ["0.5,0.5"]}
    assert not call("select", photos=["a.png", "b.png"], marks=marks)[2]
    assert not (place / "outside").exists()
    for name in ("edit-1.ply", "selection-2"):
        (place / "work" / name).unlink()


def test_nothing_is_written_outside_of_the_folder(edited, place):
    assert sorted(path.name for path in place.iterdir()) == ["quick.yaml", "work"]


def test_the_command_serves_over_standard_input_and_output(place):
    program = ["-m", "edit3r", "mcp", "--folder", str(place / "new" / "work")]

    async def listed():
        command = StdioServerParameters(
            command=sys.executable, args=program, env=dict(os.environ)
        )
        async with Client(command) as client:
            tools = (await client.list_tools()).tools
            return {tool.name: tool.description for tool in tools}

    told = anyio.run(listed)
    assert [*told] == ["select", "edit", "look", "export"]
    assert "glb: glTF with the extension" in told["export"]
    (place / "new" / "work").rmdir()
    (place / "new").rmdir()


SPEAKS = """
import json, sys, time
line = {"event": "progress", "text": "matching", "done": 3, "total": 12}
print(json.dumps(line), file=sys.stderr)
sys.stderr.flush()
time.sleep(float(sys.argv[sys.argv.index("edit3r") + 1]))
"""


class Assistant:
    """What a tool tells while it goes on."""

    def __init__(self):
        self.told = []

    async def report_progress(self, progress, message):
        self.told.append((progress, message))


@pytest.fixture
def speaking(monkeypatch):
    """Every command only says how far it is, and takes the seconds it is given."""
    monkeypatch.setattr(tools, "TOLD_EVERY", 0.05)
    monkeypatch.setattr(tools, "PYTHON", [sys.executable, "-c", SPEAKS])


def test_an_assistant_is_told_how_far_a_command_is(speaking, tmp_path):
    there, assistant = tools.Tools(tmp_path, None, 60), Assistant()
    assert anyio.run(there._command, assistant, "0.4") == ""
    seconds = [progress for progress, _ in assistant.told]
    assert seconds == sorted(seconds) and len(seconds) > 2
    assert assistant.told[-1][1] == "matching: 3 of 12"


def test_a_command_that_takes_longer_than_the_limit_is_ended(speaking, tmp_path):
    there = tools.Tools(tmp_path, None, 0.3)
    with pytest.raises(tools.ToolError, match=r"Not done within 0.3 s.*--limit"):
        anyio.run(there._command, Assistant(), "60")


def test_ten_exports_at_once_all_get_a_name(monkeypatch, tmp_path):
    (tmp_path / "edit-1").mkdir()
    (tmp_path / "edit-1" / "run.json").touch()

    async def written(command, out, error, context):
        file = Path(command[-1].removeprefix("--out="))
        free = not file.exists()
        await anyio.sleep(0.01)
        file.touch()
        out.touch()
        return 0 if free else error.write_text("is already there")

    async def ten():
        there = tools.Tools(tmp_path, None, 60)
        async with anyio.create_task_group() as group:
            for _ in range(10):
                group.start_soon(there.export, "edit-1", "ply", Assistant())

    monkeypatch.setattr(tools, "ended", written)
    anyio.run(ten)
    assert len(list(tmp_path.glob("*.ply"))) == 10


def test_a_limit_of_nothing_is_one_sentence(place, capsys):
    assert main(["mcp", "--folder", str(place / "work"), "--limit", "0"]) == 2
    assert "--limit 0: expected seconds above 0" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_one_sentence(place, capsys):
    assert main(["mcp", "--folder", str(place / "quick.yaml")]) == 2
    assert "cannot be made" in capsys.readouterr().err


def test_a_splat_is_edited_in_place_of_photos(call, place):
    save_ply(place / "work" / "scan.ply", scan())
    text, image, failed = call(
        "edit", prompt="make everything black and white", photos=["scan.ply"]
    )
    assert not failed and "all others are as they came" in text
    assert image.size[0] > 100
    run = text.split()[1]
    assert (place / "work" / run / "scene.ply").is_file()
