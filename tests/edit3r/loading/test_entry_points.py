"""One distribution's fault is its own, names are owned, and what is loaded can be chosen."""

import sys
from functools import partial
from importlib import metadata

import pytest

from edit3r.contract.errors import InputError, UnknownComponentError
from edit3r.loading import entry_points
from edit3r.loading.load import load_plugins
from edit3r.loading.registry import Registry

DECLARATION = """
from edit3r import Component, hookimpl


@hookimpl
def register_editors():
    return [Component("{name}", "nowhere:Thing", "an editor")]
"""


@pytest.fixture
def site(monkeypatch, tmp_path):
    """A function that writes a distribution into a folder that alone is looked at."""
    only = partial(metadata.distributions, path=[str(tmp_path)])
    monkeypatch.setattr(entry_points.metadata, "distributions", only)
    monkeypatch.delenv("EDIT3R_PLUGINS", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)

    def write(package, points="", offers="", requires=(), folder="", meta=None):
        module = package.replace("-", "_")
        if offers:
            (tmp_path / f"{module}.py").write_text(DECLARATION.format(name=offers))
            points = points or f"[edit3r]\n{offers} = {module}\n"
        info = tmp_path / (folder or f"{module}-1.5.dist-info")
        info.mkdir()
        text = f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.5\n"
        text += "".join(f"Requires-Dist: {one}\n" for one in requires)
        if meta != "":
            (info / "METADATA").write_text(meta or text)
        if points:
            data = points if isinstance(points, bytes) else points.encode()
            (info / "entry_points.txt").write_bytes(data)

    yield write
    for module in set(sys.modules) - before:
        del sys.modules[module]


def offered():
    return {offer.qualified_name for offer in load_plugins().offers}


BROKEN = {
    "an empty folder without a name": ({"folder": ".dist-info", "meta": ""}, ""),
    "a line without =": ({"points": "[console_scripts]\nfoo\n"}, "has no '='"),
    "a line of ours without =": ({"points": "[edit3r]\nfoo\n"}, "has no '='"),
    "UTF-16": ({"points": "[edit3r]\nfoo = foo\n".encode("utf-16")}, "codec"),
    "Latin-1": ({"points": "[edit3r]\nläufer = l\n".encode("latin-1")}, "codec"),
    "no METADATA": ({"points": "[edit3r]\na = b\n", "meta": ""}, "METADATA is missing"),
    "METADATA without a name": (
        {"points": "[edit3r]\na = b\n", "meta": "Version: 1\n"},
        "METADATA is missing or has no name",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_distribution_that_cannot_be_read_is_named_with_its_folder(case, site):
    made, reason = BROKEN[case]
    site("half-there", **made)
    site("edit3r-lamp", offers="lamp")
    loaded = load_plugins()
    assert [offer.qualified_name for offer in loaded.offers] == ["lamp:lamp"]
    (failure,) = loaded.failures
    assert made.get("folder", "half_there-1.5.dist-info") in failure.reason
    assert reason in failure.reason and "delete the folder" in failure.reason


@pytest.mark.parametrize("points", ["", "\n# nothing\n", "[console_scripts]\na = b:c"])
def test_a_sound_distribution_of_others_is_passed_over_in_silence(points, site):
    site("numpy", points=points)
    assert load_plugins() == type(load_plugins())((), ())


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (
            "edit3r_gone",
            "its module edit3r_gone is not there; install edit3r-odd again",
        ),
        ("edit3r_gone.sub", "its module edit3r_gone.sub is not there"),
        ("edit3r-lamp", 'names no module; in its package write odd = "edit3r_lamp"'),
        ("edit3r_lamp:", 'names no module; in its package write odd = "edit3r_lamp"'),
        ("os:sep", "is a str, expected the module with the hooks"),
        (
            "collections:OrderedDict",
            "is a type, expected the module with the hooks: odd =",
        ),
        ("os:nothing_there", "has no attribute 'nothing_there'"),
    ],
)
def test_an_entry_point_that_leads_nowhere_says_what_to_do(value, sentence, site):
    site("edit3r-odd", points=f"[edit3r]\nodd = {value}\n")
    (failure,) = load_plugins().failures
    assert failure.plugin == "odd" and sentence in failure.reason


def test_a_module_that_lacks_another_is_not_called_gone(site, tmp_path):
    site("edit3r-lamp", offers="lamp")
    (tmp_path / "edit3r_lamp.py").write_text("import surely_not_there")
    assert "list it in requires" in load_plugins().failures[0].reason


def test_edit3r_s_own_plugin_keeps_its_name_and_the_stranger_s_takes_its_distribution_s(
    site,
):
    site("a-first", points="[edit3r]\nrecolor = a_first\n", offers="recolor")
    site("edit3r", points="[edit3r]\nrecolor = edit3r_own\n")
    site("edit3r-own", offers="recolor", points="[nothing]\n")
    registry = Registry(load_plugins())
    names = {offer.qualified_name for offer in registry.offers()}
    assert names == {"recolor:recolor", "a-first:recolor"}
    assert registry.find("editor", "recolor").first_party
    assert not registry.find("editor", "a-first:recolor").first_party
    renamed, offered_twice = registry.clashes()
    assert "'recolor' of a-first is called 'a-first' here, because edit3r" in renamed
    assert "without a plugin's name it is edit3r's own" in offered_twice


def test_a_local_file_with_the_name_of_our_own_component_is_asked_about(site, tmp_path):
    site("edit3r", points="[edit3r]\nrecolor = edit3r_own\n")
    site("edit3r-own", offers="recolor", points="[nothing]\n")
    file = tmp_path / "mine.py"
    file.write_text(DECLARATION.format(name="recolor"))
    with pytest.raises(UnknownComponentError, match="'mine:recolor'"):
        Registry(load_plugins([file])).find("editor", "recolor")


def test_two_strangers_with_one_name_are_told_apart(site):
    site("b-two", points="[edit3r]\nsepia = b_two\n", offers="two")
    site("a-one", points="[edit3r]\nsepia = a_one\n", offers="one")
    site("sepia", points="[edit3r]\nsepia = c_three\n")
    site("c-three", offers="three", points="[nothing]\n")
    assert offered() == {"sepia:one", "b-two:two", "sepia-sepia:three"}


@pytest.mark.parametrize(
    ("choice", "kept"),
    [
        ("", {"ours", "lamp", "lens"}),
        ("none", {"ours"}),
        ("lamp", {"ours", "lamp"}),
        ("edit3r-lens", {"ours", "lens"}),
        ("-lamp", {"ours", "lens"}),
        ("-ours, -edit3r-lens", {"lamp"}),
    ],
)
def test_the_environment_chooses_what_is_loaded(choice, kept, site, monkeypatch):
    site("edit3r", points="[edit3r]\nours = edit3r_own\n")
    site("edit3r-own", offers="ours", points="[nothing]\n")
    site("edit3r-lamp", offers="lamp")
    site("edit3r-lens", offers="lens")
    monkeypatch.setenv("EDIT3R_PLUGINS", choice)
    assert offered() == {f"{name}:{name}" for name in kept}


def test_a_plugin_to_load_that_is_not_installed_is_refused(site, monkeypatch):
    site("edit3r-lamp", offers="lamp")
    monkeypatch.setenv("EDIT3R_PLUGINS", "-lamb")
    with pytest.raises(InputError, match=r"no plugin 'lamb'.*'lamp'"):
        load_plugins()


@pytest.mark.parametrize(
    ("requires", "loads"),
    [
        (("edit3r",), True),
        (("edit3r>=0.0.1", "numpy"), True),
        (("edit3r[test]>=99; extra == 'test'",), True),
        (("edit3r-lens>=99",), True),
        (("edit3r>=99",), False),
        (("edit3r (<0.0.1)",), False),
    ],
)
def test_a_plugin_for_another_edit3r_says_both_versions(requires, loads, site):
    site("edit3r-lamp", offers="lamp", requires=requires)
    loaded = load_plugins()
    assert bool(loaded.offers) == loads
    if not loads:
        reason = loaded.failures[0].reason
        assert "needs edit3r" in reason and entry_points.__version__ in reason
        assert "pip install" in reason
