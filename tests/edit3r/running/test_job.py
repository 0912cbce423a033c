"""What a run is asked to do, from flags."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from edit3r.cli.main import main
from edit3r.running.job import JobInputs, job_from
from edit3r.running.run_folder import RunFolder

README = Path(__file__).parents[3] / "README.md"


@pytest.mark.parametrize("settings", [{}, {"editor": "recolor"}])
def test_the_packaged_pair_brings_masks_of_its_motorcycle(settings):
    job = job_from(JobInputs(), settings)
    assert [Path(file).is_file() for file in job.masks.mask_files] == [True, True]


@pytest.mark.parametrize(
    ("inputs", "settings"),
    [
        ({}, {"prompt": "make it warmer"}),
        ({}, {"editor": "none"}),
        ({"point": ("320,240",)}, {}),
    ],
)
def test_it_brings_none_where_another_thing_or_a_mark_is_meant(inputs, settings):
    masks = job_from(JobInputs(**inputs), settings).masks
    assert masks is None or not masks.mask_files


@pytest.mark.slow
def test_the_first_command_of_the_readme_finds_its_thing(tmp_path, monkeypatch):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path / "none"))
    command = re.search(r"edit3r (run .*)", README.read_text(encoding="utf-8"))[1]
    sheet = tmp_path / "sheet.png"
    words = [*command.split(), f"--preview={sheet}", "--size", "128"]
    try:
        assert main(words) == 0
    except SystemExit as ended:
        assert ended.code == 0
    assert sheet.is_file()


def test_another_editor_does_not_inherit_the_usual_sentence():
    looks = {"editor": {"name": "looks", "look": "sketch"}}
    assert job_from(JobInputs(), looks).config.prompt == ""
    assert job_from(JobInputs(), {}).config.prompt == "paint the motorcycle blue"


def test_photos_beside_an_earlier_run_are_edited_from_the_start(monkeypatch):
    """With its settings, and without its scene."""
    choice = {"name": "edit3r"}
    settings = {"frames": 7, "reconstructor": choice, "matcher": {"name": "auto"}}
    earlier = SimpleNamespace(settings=settings)
    monkeypatch.setattr(RunFolder, "read", lambda *_: earlier)
    job = job_from(JobInputs(photos=("a.png",), earlier="before"))
    assert job.earlier is None and job.config.frames == 7
    assert job_from(JobInputs(earlier="before")).earlier is earlier
