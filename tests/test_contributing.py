"""What a contributor and the hosted checks are told is what `.ci/run` does."""

from pathlib import Path

import pytest
import yaml

import edit3r

ROOT = Path(__file__).parents[1]
CHECKS = (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def read(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def test_every_system_and_python_runs_the_steps_of_the_local_check():
    jobs = read(".github/workflows/ci.yml")["jobs"]
    assert jobs["all"]["steps"][-1]["run"] == "bash .ci/run"
    systems = jobs["systems"]
    commands = [step["run"] for step in systems["steps"] if "run" in step]
    steps = CHECKS[CHECKS.index("install -q -c constraints.txt -e") :]
    own = [line.partition("  #")[0] for line in steps.splitlines()]
    assert commands == [f"pip {own[0]}", *own[1:]]
    matrix = systems["strategy"]["matrix"]
    assert [name.partition("-")[0] for name in matrix["os"]] == [
        "ubuntu",
        "macos",
        "windows",
    ]
    assert matrix["python"] == ["3.10", "3.11", "3.12", "3.13"]
    assert 'requires-python = ">=3.10"' in (ROOT / "pyproject.toml").read_text()


def test_the_contributor_is_told_the_same_commands():
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    block = page.partition("Before you send a change\n\n```sh\n")[2]
    for command in block.partition("```")[0].splitlines():
        assert command in CHECKS


def test_ruff_runs_before_a_commit():
    (own,) = read(".pre-commit-config.yaml")["repos"]
    entries = [hook["entry"].removesuffix(" --force-exclude") for hook in own["hooks"]]
    assert entries == ["ruff check", "ruff format"]


@pytest.mark.parametrize("form", ["bug", "wish"])
def test_a_form_for_issues_has_questions(form):
    content = read(f".github/ISSUE_TEMPLATE/{form}.yml")
    assert content["name"] and content["description"]
    names = [question["id"] for question in content["body"]]
    assert len(set(names)) == len(names)
    assert all(question["attributes"]["label"] for question in content["body"])


def test_the_citation_has_this_version_and_the_paper():
    citation = read("CITATION.cff")
    assert citation["version"] == edit3r.__version__
    assert citation["references"][0]["title"].startswith("Edit3r: Instant 3D")
