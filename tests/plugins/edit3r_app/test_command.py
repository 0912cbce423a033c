"""`edit3r app`: what is wrong with its arguments is said before anything is made."""

import pytest

from edit3r.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--port", "-1"], "0 to 65535"),
        (["--port", "70000"], "0 to 65535"),
        (["--size", "4"], "8 to 8192"),
        (["--root-path", "edit3r/../x"], "expected a path such as /edit3r"),
        (["nope.jpg"], "nope.jpg: no such file"),
        (["--host", "999.1.1.1"], "--host 999.1.1.1: cannot be listened on"),
    ],
)
def test_wrong_arguments_are_one_sentence_and_leave_no_folder(
    arguments, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["app", "--no-browser", *arguments]) == 2
    assert told in capsys.readouterr().err and not list(tmp_path.iterdir())
