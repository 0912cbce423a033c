"""Guarded loading: whatever one plugin does, it is one line, and every other plugin still works."""

import sys
from functools import partial
from importlib import metadata

import pytest

from edit3r.contract.errors import InputError
from edit3r.loading import entry_points
from edit3r.loading.load import load_plugins

DECLARATION = """
from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_editors():
    return [Component("{name}", "{module}:Thing", "an editor")]
"""

BROKEN = {
    "raises on import": ("raise RuntimeError('no luck')", "RuntimeError: no luck"),
    "has a syntax error": ("def", "SyntaxError"),
    "needs what is not installed": ("import surely_not_there", "list it in requires"),
    "calls sys.exit": ("import sys; sys.exit(3)", "called sys.exit(3) while loading"),
    "skips like a test": (
        "import pytest; pytest.skip('no', allow_module_level=True)",
        "Skipped",
    ),
    "offers nothing": ("x = 1", "offers nothing"),
    "misspells a hook": (
        "from edit3r import hookimpl\n@hookimpl\ndef register_editor():\n    return []",
        "'register_editor' is not an edit3r hook. Did you mean 'register_editors'?",
    ),
    "forgets to mark a hook": (
        "def register_editors():\n    return []",
        "put @edit3r.hookimpl above it",
    ),
    "gives a hook an argument": (
        "from edit3r import hookimpl\n@hookimpl\ndef register_editors(registry):\n    return []",
        "registry",
    ),
    "raises in a hook": (
        "from edit3r import hookimpl\n@hookimpl\ndef register_editors():\n    return 1 / 0",
        "ZeroDivisionError",
    ),
    "exits in a hook": (
        "from edit3r import hookimpl\n@hookimpl\ndef register_editors():\n    raise SystemExit",
        "called sys.exit(None)",
    ),
    "offers a class": (
        "from edit3r import hookimpl\n@hookimpl\ndef register_editors():\n    return [dict]",
        "expected edit3r.Component",
    ),
    "offers a number": (
        "from edit3r import hookimpl\n@hookimpl\ndef register_editors():\n    return 7",
        "expected a list of edit3r.Component",
    ),
    "offers one name twice": (
        "from edit3r import Component, hookimpl\n@hookimpl\ndef register_editors():\n"
        "    return [Component('a', 'm:A', 's'), Component('a', 'm:B', 's')]",
        "offers 'a' twice",
    ),
    "names a component badly": (
        "from edit3r import Component, hookimpl\n@hookimpl\ndef register_editors():\n"
        "    return [Component('My Editor', 'm:A', 's')]",
        "must be lower-case letters",
    ),
    "is of a later API": (
        "EDIT3R_API = 2",
        "written for edit3r API 2, this edit3r has API 1; install a newer edit3r",
    ),
    "is of an older API": ("EDIT3R_API = 0", "install a newer version of the plugin"),
    "states a strange API": (
        "EDIT3R_API = '1.0'",
        "EDIT3R_API must be a whole number such as 1, got '1.0'",
    ),
}


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """A function that 'installs' plugin modules, given as entry point name to source, for this test
    only.
    """
    only = partial(metadata.distributions, path=[str(tmp_path)])
    monkeypatch.setattr(entry_points.metadata, "distributions", only)
    monkeypatch.delenv("EDIT3R_PLUGINS", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)

    def install(distribution: str = "", requires: str = "", **sources: str) -> None:
        for name, source in sources.items():
            package = distribution or name
            module = f"{package.replace('-', '_')}_{name}_declaration"
            (tmp_path / f"{module}.py").write_text(
                source.format(name=name, module=module)
            )
            folder = tmp_path / f"{package.replace('-', '_')}-1.5.dist-info"
            folder.mkdir(exist_ok=True)
            needs = f"Requires-Dist: {requires}\n" if requires else ""
            (folder / "METADATA").write_text(
                f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.5\n{needs}"
            )
            with (folder / "entry_points.txt").open("a") as listed:
                listed.write(f"[edit3r]\n{name} = {module}\n")

    yield install
    for module in set(sys.modules) - before:
        del sys.modules[module]


@pytest.mark.parametrize("case", BROKEN)
def test_a_plugin_that(case, installed):
    source, reason = BROKEN[case]
    installed(broken=source.replace("{", "{{").replace("}", "}}"), good=DECLARATION)
    loaded = load_plugins()
    assert [offer.component.name for offer in loaded.offers] == ["good"]
    assert [failure.plugin for failure in loaded.failures] == ["broken"]
    assert reason in loaded.failures[0].reason
    assert "\n" not in loaded.failures[0].reason


def test_ctrl_c_while_loading_is_not_swallowed(installed):
    installed(broken="raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        load_plugins()


def test_two_packages_with_one_entry_point_name_both_load_under_names_that_differ(
    installed,
):
    source = DECLARATION.replace("{name}", "from-{module}").replace("_declaration", "")
    installed(distribution="edit3r-one", sepia=source.replace("from-{module}", "one"))
    installed(distribution="edit3r-two", sepia=source.replace("from-{module}", "two"))
    offers = load_plugins().offers
    assert {offer.qualified_name for offer in offers} == {"sepia:one", "edit3r-two:two"}


def test_a_plugin_that_states_no_api_is_taken_for_the_current_one(installed):
    installed(silent=DECLARATION.replace("EDIT3R_API = 1", ""))
    assert not load_plugins().failures


def test_a_helper_that_only_looks_like_a_hook_is_left_alone(installed):
    installed(
        helpful=DECLARATION + "\n\ndef register_with_the_tax_office():\n    pass\n"
    )
    assert not load_plugins().failures


def test_a_local_file_loads_only_when_named(installed, tmp_path):
    installed(good=DECLARATION)
    file = tmp_path / "local_thing.py"
    file.write_text(DECLARATION.format(name="local", module="local_thing"))
    assert {offer.component.name for offer in load_plugins().offers} == {"good"}
    offers = {offer.component.name: offer for offer in load_plugins([file]).offers}
    assert set(offers) == {"good", "local"}
    assert offers["local"].plugin == "local_thing"
    assert offers["local"].version == ""


def test_a_local_folder_loads_as_a_package_with_its_modules(installed, tmp_path):
    folder = tmp_path / "elsewhere" / "local_package"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text(
        DECLARATION.format(name="packed", module="local_package.editor")
    )
    (folder / "editor.py").write_text("class Thing:\n    pass\n")
    (offer,) = load_plugins([folder]).offers
    from local_package.editor import Thing

    assert offer.component.target == f"{Thing.__module__}:{Thing.__name__}"


def test_naming_an_installed_plugin_s_file_changes_nothing(installed, tmp_path):
    installed(good=DECLARATION)
    loaded = load_plugins([tmp_path / "good_good_declaration.py"])
    assert [offer.component.name for offer in loaded.offers] == ["good"]
    assert not loaded.failures


def test_a_local_file_that_fails_leaves_no_half_module_behind(installed, tmp_path):
    file = tmp_path / "half_way.py"
    file.write_text("x = 1\nraise ValueError('stopped half-way')")
    assert load_plugins([file]).failures[0].reason == "stopped half-way"
    assert "half_way" not in sys.modules


def test_a_local_file_may_not_take_the_name_of_another_module(installed, tmp_path):
    file = tmp_path / "json.py"
    file.write_text(DECLARATION.format(name="json", module="json"))
    assert "rename json.py" in load_plugins([file]).failures[0].reason


def test_a_local_file_that_is_not_there_is_the_user_s_error(installed, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_plugins([tmp_path / "absent.py"])


def test_a_local_file_that_offers_nothing_is_named_each_time_it_is_asked_for(
    installed, tmp_path
):
    """A plugin that failed is not taken for one that is loaded already."""
    file = tmp_path / "empty_handed.py"
    file.write_text("x = 1")
    failures = load_plugins([file, file]).failures
    assert len(failures) == 2 and "offers nothing" in failures[1].reason


def test_what_a_plugin_prints_on_import_never_reaches_standard_output(installed, capfd):
    loud = "import os\nprint('hello')\nos.system('echo there')\n"
    installed(loud=f"{loud}{DECLARATION}")
    (offer,) = load_plugins().offers
    assert offer.component.name == "loud"
    out, err = capfd.readouterr()
    assert not out and "hello" in err and "there" in err


def test_the_folder_of_a_new_plugin_stands_for_its_only_package(installed, tmp_path):
    for name in ("edit3r_sepia", "tests"):
        (tmp_path / "edit3r-sepia" / name).mkdir(parents=True)
        source = DECLARATION.format(name="sepia", module=name)
        (tmp_path / "edit3r-sepia" / name / "__init__.py").write_text(source)
    (offer,) = load_plugins([tmp_path / "edit3r-sepia"]).offers
    assert offer.component.name == "sepia" and offer.plugin == "edit3r_sepia"
    (tmp_path / "edit3r-sepia" / "another").mkdir()
    (tmp_path / "edit3r-sepia" / "another" / "__init__.py").touch()
    with pytest.raises(InputError, match=r"give one: .*another, .*edit3r_sepia"):
        load_plugins([tmp_path / "edit3r-sepia"])
