"""Actions on objects as the page asks for them: checked, and put into words of a command line."""

import pytest
from edit3r_app.jobs import AppJob, JobsFolder, objects_of
from edit3r_app.objects import read_action
from edit3r_app.runner import command_of

from edit3r.contract.errors import InputError


@pytest.mark.parametrize(
    ("asked", "call"),
    [
        ({"action": "find"}, ("find",)),
        ({"action": "remove", "name": "caf\u00e9"}, ("remove", "caf\u00e9")),
        (
            {"action": "move", "name": "cup", "numbers": [0.1, 0, -0.25]},
            ("move", "cup", "0.1", "0", "-0.25"),
        ),
        ({"action": "turn", "name": "cup", "numbers": [-15]}, ("turn", "cup", "-15")),
        (
            {"action": "recolor", "name": "cup", "text": " dark green "},
            ("recolor", "cup", "dark green"),
        ),
        (
            {"action": "copy", "name": "cup", "text": "twin", "numbers": [1, 0, 0]},
            ("copy", "cup", "twin", "1", "0", "0"),
        ),
        ({"action": "measure", "text": "3.5=69.4 cm"}, ("measure", "3.5=69.4 cm")),
    ],
)
def test_an_action_is_a_command_line_of_edit3r_objects(asked, call):
    assert read_action(asked).call == call


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({}, "not something"),
        ({"action": "isolate", "name": "cup"}, "not something"),
        ({"action": "find", "mask": "/etc/passwd"}, "not something"),
        ({"action": "move", "name": "cup"}, "not something"),
        ({"action": "turn", "name": "cup", "numbers": ["x"]}, "not something"),
        ({"action": "turn", "name": "cup", "numbers": [float("nan")]}, "not something"),
        ({"action": "scale", "name": "cup", "numbers": [1e6]}, "not something"),
        ({"action": "remove", "name": "c" * 99}, "not something"),
        ({"action": "remove", "name": " "}, "give the thing a name"),
        ({"action": "recolor", "name": "cup"}, "say a colour"),
        ({"action": "measure"}, "say how long it is"),
        ({"action": "measure", "text": "3.5="}, "the true length: a length must be"),
        ({"action": "measure", "text": "3.5=3 yards"}, "got the unit 'yards'"),
    ],
)
def test_what_is_no_action_is_refused(asked, told):
    with pytest.raises(InputError, match=told):
        read_action(asked)


def test_words_of_an_action_never_become_flags(tmp_path):
    folder = JobsFolder(tmp_path)
    (folder.root / "bike").mkdir()
    action = read_action({"action": "remove", "name": "overwrite"})
    job = AppJob("bike-1", "bike", parent="bike", object=action, masks=1)
    command = command_of(folder, job)
    assert command[:2] == ["objects", "--quiet"]
    assert command[-4:] == ["--", str(folder.root / "bike"), "remove", "overwrite"]
    assert command[command.index("--mask") + 1].endswith("000.png")


@pytest.mark.parametrize("content", ['{"objects": 5}', '{"objects": null}', "[", "{}"])
def test_a_manifest_of_a_stranger_names_no_objects(tmp_path, content):
    folder = JobsFolder(tmp_path)
    (folder.root / "bike").mkdir()
    (folder.root / "bike" / "run.json").write_text(content)
    assert objects_of(folder, "bike") == []
    (folder.root / "bike" / "run.json").write_text('{"objects": {"cup": 0, "tap": 1}}')
    assert objects_of(folder, "bike") == ["cup", "tap"]
