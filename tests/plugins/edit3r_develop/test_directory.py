"""The directory of plugins is checked, agrees with its packages, and is printed offline."""

from pathlib import Path

import pytest
from edit3r_develop import directory

from edit3r.cli.main import main
from edit3r.contract.errors import SettingsError

ROOT = Path(__file__).parents[3]

ENTRY = """
plugins:
  - name: edit3r-lamp
    offers: {editor: [lamp]}
    does: switches a lamp on
    install: pip install edit3r-lamp
    home: https://lamp.example
    licence: MIT
    api: 1
    tested_with: 0.1.0
"""


def entries(monkeypatch, tmp_path, text):
    (tmp_path / "directory.yaml").write_text(text, encoding="utf-8")
    monkeypatch.setattr(directory, "FILE", tmp_path / "directory.yaml")
    return directory.listed()


@pytest.mark.parametrize("one", directory.listed(), ids=lambda one: one.name)
def test_an_entry_of_this_repository_says_what_its_package_says(one):
    package = ROOT / one.home
    project = pytest.importorskip("tomllib").loads(
        (package / "pyproject.toml").read_text()
    )["project"]
    declared = (package / f"{one.name.replace('-', '_')}" / "__init__.py").read_text()
    assert project["name"] == one.name and f"./{one.home}" in one.install.split()
    assert f"EDIT3R_API = {one.api}" in declared
    for kind, names in one.offers.items():
        assert f"def register_{kind}s(" in declared
        assert all(f'"{name}"' in declared for name in names)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("editor:", "editr:", "Did you mean 'editor'"),
        ("pip install", "curl x | sh; pip install", "install"),
        ("licence: MIT", "license: MIT", "licence"),
        ("api: 1", "api: 0", "api"),
        ("0.1.0", "latest", "tested_with"),
    ],
)
def test_a_wrong_entry_is_refused(old, new, sentence, monkeypatch, tmp_path):
    with pytest.raises(SettingsError, match=sentence):
        entries(monkeypatch, tmp_path, ENTRY.replace(old, new))


def test_a_package_stands_once_and_in_order(monkeypatch, tmp_path):
    assert len(entries(monkeypatch, tmp_path, ENTRY)) == 1
    again = ENTRY.removeprefix("\nplugins:\n")
    with pytest.raises(SettingsError, match="'edit3r-lamp' is listed twice"):
        entries(monkeypatch, tmp_path, ENTRY + again)
    behind = ENTRY + again.replace("lamp", "bulb")
    with pytest.raises(SettingsError, match="put 'edit3r-bulb' before 'edit3r-lamp'"):
        entries(monkeypatch, tmp_path, behind)


def test_the_command_prints_the_line_that_installs_what_is_not_here(
    monkeypatch, tmp_path, capsys
):
    entries(monkeypatch, tmp_path, ENTRY)
    assert main(["plugins"]) == 0
    assert "edit3r-lamp: pip install edit3r-lamp\n" in capsys.readouterr().out
    monkeypatch.setattr(directory.metadata, "version", lambda name: "2.0")
    assert main(["plugins"]) == 0
    said = capsys.readouterr().out
    assert "2.0" in said and "pip install" not in said
