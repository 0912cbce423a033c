"""`edit3r list-plugins`: one line for everything that is wrong, the rest listed all the same."""

import json

import pytest

from edit3r.cli.main import main

PLUGIN = """
from edit3r import Component, hookimpl
from edit3r.contract.interfaces import Editor


class Fine(Editor):
    def edit(self, views, request):
        return views


@hookimpl
def register_editors():
    return [
        Component("listed-fine", "listed_locally:Fine", "does nothing", licence="MIT"),
        Component("listed-abstract", "edit3r.contract.interfaces:Editor", "does not exist"),
        Component(
            "listed-needy", "listed_locally:Fine", "needs much",
            requires=("surely_not_there",), extra="much",
        ),
        Component("none", "listed_locally:Fine", "takes a name"),
    ]
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("local")
    (folder / "listed_locally.py").write_text(PLUGIN)
    (folder / "listed_broken.py").write_text("EDIT3R_API = 99")
    return [
        f"--plugin={folder / name}.py" for name in ("listed_locally", "listed_broken")
    ]


def lines(capsys):
    return [line.rstrip() for line in capsys.readouterr().out.splitlines()]


def test_everything_wrong_is_one_line(files, capsys):
    assert main(["list-plugins", "--kind", "editor", "--check", *files]) == 0
    said = lines(capsys)
    for expected in (
        "problem: editor 'listed-abstract': Editor does not implement edit",
        '* editor listed-needy needs surely_not_there; install with: pip install "edit3r[much]"',
        "failed: plugin listed_broken: written for edit3r API 99, this edit3r has API 1; install "
        "a newer edit3r",
        "note: editor 'none' is offered by editors and listed_locally; ask for editors:none or "
        "listed_locally:none",
    ):
        assert expected in said
    assert any(
        line.startswith("editor") and "listed-fine" in line and "MIT" in line
        for line in said
    )


def test_strict_turns_it_into_an_exit_code(files, capsys):
    assert main(["list-plugins", "--strict", *files]) == 1


def test_without_check_nothing_is_imported_and_no_problem_is_told(files, capsys):
    assert main(["list-plugins", "--kind", "editor", *files]) == 0
    assert not any(line.startswith("problem:") for line in lines(capsys))


def test_json_says_the_same(files, capsys):
    assert main(["list-plugins", "--kind", "editor", "--check", "--json", *files]) == 0
    content = json.loads(capsys.readouterr().out)
    rows = {(row["plugin"], row["name"]): row for row in content["components"]}
    assert (
        "does not implement edit"
        in rows["listed_locally", "listed-abstract"]["problem"]
    )
    strength = rows["recolor", "recolor"]["settings"]["strength"]
    assert strength["allowed"] == "float, ≥ 0, ≤ 1" and strength["description"]
    assert content["failures"][0]["plugin"] == "listed_broken"
    assert len(content["clashes"]) == 1


def test_one_kind_lists_only_that_kind(capsys):
    assert main(["list-plugins", "--kind", "rasterizer", "--json"]) == 0
    assert {
        row["kind"] for row in json.loads(capsys.readouterr().out)["components"]
    } == {"rasterizer"}


def test_texts_of_plugins_are_cut_and_command_no_terminal(tmp_path, capsys):
    file = tmp_path / "loud.py"
    file.write_text(
        "from edit3r import Component, hookimpl\n"
        "@hookimpl\n"
        "def register_editors():\n"
        "    text = '\\x1b[31m' + 'long ' * 2000\n"
        "    return [Component('loud', 'loud:Loud', text)]\n"
    )
    assert main(["list-plugins", "--kind", "editor", "--plugin", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "loud" in printed and "\x1b" not in printed and len(printed) < 20_000
