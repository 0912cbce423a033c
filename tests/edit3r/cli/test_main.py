"""Wrong use ends with exit code 2 and one sentence; help and lists are quick because nothing heavy
is imported.
"""

import errno
import subprocess
import sys

import pytest

from edit3r.cli.main import main


def test_an_unknown_command_is_one_sentence_with_a_suggestion(capsys):
    assert main(["rn"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "Did you mean 'run'?" in error


def test_an_unknown_option_is_one_sentence_with_a_suggestion(capsys):
    assert main(["run", "--promt", "x"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "Did you mean '--prompt'?" in error


def test_no_command_shows_the_overview_and_says_it_was_wrong(capsys):
    assert main([]) == 2
    assert "run" in capsys.readouterr().out


def test_unknown_components_end_the_run_before_anything_else(capsys, tmp_path):
    assert main(["run", "--editor", "recolour", "--out", str(tmp_path / "out")]) == 2
    assert "Did you mean 'recolor'?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_program_is_main_and_leaves_without_a_search_for_cycles():
    code = "import gc, sys; from edit3r.cli.main import program; print(program(), gc.get_freeze_count() > 0)"
    done = subprocess.run(
        [sys.executable, "-c", code, "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith("edit3r ") and done.stdout.split()[-2:] == [
        "0",
        "True",
    ]


def test_options_and_photos_may_be_mixed(capsys, tmp_path):
    missing = str(tmp_path / "a.jpg")
    assert (
        main(
            [
                "run",
                missing,
                "--prompt",
                "x",
                str(tmp_path / "b.jpg"),
                "--editor",
                "none",
            ]
        )
        == 2
    )
    assert "a.jpg" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["list-plugins"]])
def test_help_and_lists_import_no_torch(arguments):
    code = (
        "import sys\nfrom edit3r.cli.main import main\n"
        f"try:\n    main({arguments!r})\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'numba', 'cv2', 'kornia', 'skimage'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_what_a_default_run_is_made_of_loads_no_library_that_it_does_not_use():
    code = (
        "import sys, edit3r_recolor.editor, edit3r_segmenters.auto, edit3r_matching.matchers, "
        "edit3r_refiners.refine\n"
        "from edit3r.pipeline import steps, write\n"
        "heavy = {'kornia', 'skimage', 'scipy.optimize', 'scipy.spatial', 'scipy.ndimage'} & "
        "set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_a_reader_that_goes_away_is_no_error():
    code = "import sys; from edit3r.cli.main import program; sys.exit(program())"
    listing = subprocess.Popen(
        [sys.executable, "-c", code, "list-plugins", "--json"], stdout=subprocess.PIPE
    )
    listing.stdout.read(1)
    listing.stdout.close()
    assert listing.wait(timeout=60) == 0


def test_a_full_disk_is_one_sentence_with_the_way_out(capsys, monkeypatch):
    def full(argv):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("edit3r.cli.main._dispatch", full)
    assert main(["run"]) == 1
    assert "no space is left on the disk; free some" in capsys.readouterr().err
