"""A file that is there is replaced only with `--overwrite`, and the one that is read never is."""

import pytest

from edit3r.cli.main import main
from edit3r.kit.files.atomic import atomic_folder

COMMANDS = [
    "simplify scene.ply --out theirs.ply",
    "export scene.ply --to glb --out theirs.glb",
    "evaluate nowhere --out theirs.md",
    "run a.jpg --preview theirs.jpg",
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_that_is_there_is_left_alone(folder, command, capsys):
    theirs = folder / command.split()[-1]
    theirs.write_text("mine")
    assert main(command.split()) == 2
    assert "already exists; give another --out, or --ov" in capsys.readouterr().err
    assert theirs.read_text() == "mine"
    assert main([*command.split(), "--overwrite"]) != 0
    # what the command reads is not there either, but the file could be replaced
    assert "already exists" not in capsys.readouterr().err


@pytest.mark.parametrize("command", ["simplify scene.ply", "export scene.ply --to ply"])
def test_the_scene_that_is_read_is_never_replaced(folder, command, capsys):
    (folder / "scene.ply").write_text("mine")
    (folder / "link.ply").symlink_to("scene.ply")
    given = [*command.split(), "--out", "link.ply", "--overwrite"]
    assert main(given) == 2
    assert "a file that is read" in capsys.readouterr().err
    assert (folder / "scene.ply").read_text() == "mine"


@pytest.mark.parametrize(
    "command",
    [
        "render theirs",
        "run theirs/inputs/a.png --size 16",
        "mask theirs/inputs/a.png --point 1,1",
        "recolor theirs/inputs/a.png --quiet",
    ],
)
def test_a_run_that_is_read_is_never_replaced(folder, command, capsys):
    with atomic_folder("theirs") as run:
        (run / "scene.ply").write_text("mine")
        (run / "inputs").mkdir()
        (run / "inputs" / "a.png").write_text("mine")
    for more in ([], ["--overwrite"]):
        assert main([*command.split(), "--out", "theirs", *more]) == 2
        assert "would overwrite a file that is read" in capsys.readouterr().err
