"""Wrong use ends with exit code 2 and one sentence; help and lists are quick because nothing heavy
is imported.
"""

import errno
import os
import subprocess
import sys
from pathlib import Path

import lazy_loader
import pytest

import edit3r
from edit3r.cli.main import Parser, at_home, main, parse
from edit3r.kit.command.console import StageConsole
from edit3r.loading.registry import default_registry


@pytest.mark.parametrize(
    ("line", "meant"),
    {
        "rn": "run",
        "run --promt x": "--prompt",
        "describe editr recolor": "editor",
        "run --quiet --editor recolour --out {}/out": "recolor",
    }.items(),
)
def test_wrong_use_is_one_sentence_with_a_suggestion(capsys, tmp_path, line, meant):
    assert main(line.format(tmp_path).split()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"Did you mean {meant!r}?" in error
    assert not (tmp_path / "out").exists()


def test_what_was_given_neither_commands_the_terminal_nor_fills_it(capsys):
    assert main(["describe", "editor", "\x1b]0;title\x07\u202e" + "x" * 10**6]) == 2
    error = capsys.readouterr().err
    assert error.removesuffix("\n").isprintable() and "\\x1b]0;title" in error
    assert len(error) < 5000


def test_warnings_command_no_terminal_either(capsys):
    StageConsole()("warn", "\x1b]0;title\x07 by a file", 0, 0)
    assert "\\x1b]0;title\\x07 by a file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("--out=~/scene", "--out=HOME/scene"),
        ("editor.path=~/edited", "editor.path=HOME/edited"),
        ("~/photos", "HOME/photos"),
        ("paint it ~/ red", "paint it ~/ red"),
        ("a b=~/c", "a b=~/c"),
        ("~$draft.jpg", "~$draft.jpg"),
    ],
)
def test_the_folder_of_the_user_is_found_where_no_shell_does(monkeypatch, given, meant):
    monkeypatch.setenv("HOME", "HOME")
    monkeypatch.setenv("USERPROFILE", "HOME")
    assert at_home(given) == meant


def test_no_command_shows_the_overview_and_says_it_was_wrong(capsys):
    assert main([]) == 2
    assert "run" in capsys.readouterr().out


def program(code, *arguments):
    """A process that runs Python code, with `program` at its disposal."""
    start = "import gc, sys, signal; from edit3r.cli.program import program\n"
    return subprocess.Popen(
        [sys.executable, "-c", start + code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_threads_of_a_command_sleep_while_they_wait(monkeypatch):
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    code = "import os; program(); print(os.environ['OMP_WAIT_POLICY'])"
    out, _ = program(code, "--version").communicate(timeout=60)
    assert out.split()[-1] == "PASSIVE"


def test_the_program_is_main_and_leaves_without_a_search_for_cycles():
    code = "print(program(), gc.get_freeze_count() > 0)"
    out, _ = program(code, "--version").communicate(timeout=60)
    assert out.startswith("edit3r ") and out.split()[-2:] == ["0", "True"]


INTERRUPTED = {
    "at once": "sys.meta_path.insert(0, Interrupted('edit3r.cli.main'))",
    "while torch is imported": "sys.meta_path.insert(0, Interrupted('torch'))",
    "and a library makes an error of its own of it": """
import edit3r.cli.run
def main(*_):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise SystemError("BLAS wrapper returned with an error") from None
edit3r.cli.run.RunCommand.main = main
""",
}


@pytest.mark.parametrize("code", INTERRUPTED.values(), ids=INTERRUPTED)
def test_ctrl_c_is_exit_code_130_and_one_line(code):
    finder = """
class Interrupted:
    def __init__(self, name):
        self.name = name
    def find_spec(self, name, path=None, target=None):
        if name == self.name:
            signal.raise_signal(signal.SIGINT)
"""
    process = program(f"{finder}{code}\nsys.exit(program())", "run")
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130 and told.startswith("edit3r: interrupted"), told
    assert told.count("\n") == 1


def test_ctrl_c_is_heard_before_anything_that_takes_long_is_imported():
    code = (
        "import sys, edit3r.cli.program\nheavy = {'inspect', 'tempfile', 'pathlib'}\n"
    )
    homes = [str(Path(one.__file__).parents[1]) for one in (edit3r, lazy_loader)]
    ended = subprocess.run(
        [sys.executable, "-S", "-c", code + HEAVY],  # -S: no editable install's finder
        env={**os.environ, "PYTHONPATH": os.pathsep.join(homes)},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr


def test_options_and_photos_may_be_mixed(capsys, tmp_path):
    line = f"run {tmp_path}/a.jpg --prompt x {tmp_path}/b.jpg --editor none"
    assert main(line.split()) == 2
    assert "a.jpg" in capsys.readouterr().err


HEAVY = "sys.exit(str(heavy & set(sys.modules)) if heavy & set(sys.modules) else 0)"


@pytest.mark.parametrize("line", ["--help", "run --help", "list-plugins"])
def test_help_and_lists_import_no_torch(line):
    process = program(
        "from edit3r.cli.main import main\n"
        f"try: main({line.split()!r})\nexcept SystemExit: pass\n"
        f"heavy = {{'torch', 'numba', 'cv2', 'kornia', 'skimage'}}\n{HEAVY}"
    )
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told


COMMANDS = [offer.component.name for offer in default_registry().offers("command")]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_shows_no_default_that_is_none(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert "Undefined" not in shown and "default None" not in shown


@pytest.mark.slow
def test_what_a_default_run_is_made_of_loads_no_library_that_it_does_not_use():
    process = program(
        "import edit3r_recolor.editor, edit3r_segmenters.auto, edit3r_geometry.matchers\n"
        "import edit3r_refiners.refine\n"
        "from edit3r.running import result, run\n"
        "heavy = {'kornia', 'skimage', 'scipy.optimize', 'scipy.spatial', 'scipy.ndimage'}\n"
        f"{HEAVY}"
    )
    _, told = process.communicate(timeout=120)
    assert process.returncode == 0, told


def test_a_reader_that_goes_away_is_no_error():
    listing = program("sys.exit(program())", "list-plugins", "--json")
    listing.stdout.read(1)
    listing.stdout.close()
    assert listing.wait(timeout=60) == 0


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.ENOSPC, "no space is left on the disk; free some"),
        (errno.EFBIG, "the file became larger than this disk or its limits allow"),
    ],
)
def test_a_disk_that_takes_no_more_is_one_sentence_with_the_way_out(
    capsys, monkeypatch, number, told
):
    def full(argv):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("edit3r.cli.main._dispatch", full)
    assert main(["run"]) == 1
    assert told in capsys.readouterr().err


def test_after_two_dashes_nothing_is_an_option():
    parser = Parser(prog="edit3r")
    parser.add_argument("photos", nargs="*")
    parser.add_argument("--quiet", action="store_true")
    found = parse(parser, ["--quiet", "--", "--b.jpg", "--quiet"])
    assert found.quiet and found.photos == ["--b.jpg", "--quiet"]


def test_an_error_of_the_disk_in_a_plugins_command_is_no_fault_of_the_plugin(
    capsys, monkeypatch
):
    def full(self, arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    command = default_registry().build("command", "doctor")
    monkeypatch.setattr(type(command), "main", full)
    assert main(["doctor"]) == 1
    told = capsys.readouterr().err
    assert "no space is left on the disk" in told and "plugin" not in told
