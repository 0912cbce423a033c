"""What a release is made of agrees: versions, files that images copy, and what workflows call."""

import re
from pathlib import Path

import pytest
import yaml

from edit3r.version import __version__

ROOT = Path(__file__).parents[1]
IMAGES = ("Dockerfile", "Dockerfile.cuda")


def test_the_version_is_the_same_everywhere():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r'^version = "(.*)"$', project, re.MULTILINE)[1] == __version__
    assert citation["version"] == __version__
    assert re.search(r"^## (\S+)", changes, re.MULTILINE)[1] == __version__


@pytest.mark.parametrize("image", IMAGES)
def test_an_image_installs_extras_that_there_are_and_runs_as_nobody_special(image):
    text = (ROOT / image).read_text(encoding="utf-8")
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (extras,) = re.findall(r"/source\[([\w,]+)\]", text)
    assert all(f"\n{one} = [" in project for one in extras.split(","))
    assert re.findall(r"^USER (.*)", text, re.MULTILINE)[-1] == "edit3r"


def test_images_get_all_that_the_wheel_is_built_of():
    copied = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    built_of = {"edit3r", "edit3r_testing", "plugins", "configs", "README.md"}
    assert {f"!{one}" for one in built_of | {"LICENSE", "NOTICE"}} <= {*copied}


def test_only_a_tag_publishes_and_only_what_was_tested():
    file = ROOT / ".github" / "workflows" / "release.yml"
    jobs = yaml.safe_load(file.read_text(encoding="utf-8"))["jobs"]
    assert jobs["publish"]["if"] == "github.ref_type == 'tag'"
    assert jobs["publish"]["needs"] == "test" and jobs["test"]["needs"] == "build"
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
