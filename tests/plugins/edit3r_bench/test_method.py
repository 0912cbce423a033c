"""Methods from configurations: those that ship name what is there."""

from pathlib import Path

import pytest
from edit3r_bench.method import Method, read_methods
from edit3r_bench.oracle import ORACLE, OracleSettings

from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import PartChoice, make_settings
from edit3r.kit.files.configs import read_yaml
from edit3r.loading.registry import default_registry

SHIPPED = sorted((Path(__file__).parents[3] / "configs" / "bench").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_methods_name_components_and_settings_that_exist(path):
    registry = default_registry()
    for method in read_methods(read_yaml(path), {}):
        for kind in ("reconstructor", "rasterizer", "editor"):
            choice = getattr(method, kind)
            if choice.name == ORACLE:
                make_settings(OracleSettings, choice.settings, where="editor")
                continue
            if registry.missing(registry.find(kind, choice.name)):
                continue
            given = dict(choice.settings)
            if "weights" in given:
                given["weights"] = "untrained"  # nobody ships the files
            registry.check(kind, PartChoice(name=choice.name, settings=given))


def test_the_label_is_editor_and_reconstructor_unless_given():
    assert Method().label == "oracle+edit3r"
    assert Method(editor="none", reconstructor="classical").label == "none+classical"
    with pytest.raises(ValueError, match="may contain only letters"):
        Method(label="a/b")


def test_settings_are_laid_over_a_method_by_its_label():
    own = {"label": "a", "reconstructor": {"name": "edit3r", "opacity": 0.5}}
    fused = {"reconstructor": {"fuse_edits": False}, "poses": False, "editor": "none"}
    a, b = read_methods({"methods": [own, {"label": "b"}]}, {"a": fused})
    assert a.reconstructor.name == "edit3r"
    assert a.reconstructor.settings == {"opacity": 0.5, "fuse_edits": False}
    assert a.editor.name == "none"
    assert not a.poses
    assert b == Method(label="b")


@pytest.mark.parametrize(
    ("methods", "changes", "words"),
    [
        ([], {}, "configuration.methods"),
        ([{}, {}], {}, "two are called"),
        ([{"label": "a"}], {"c": {}}, "no such method"),
        ([{"recon": "edit3r"}], {}, "recon"),
    ],
)
def test_a_configuration_that_cannot_be_is_one_sentence(methods, changes, words):
    with pytest.raises(SettingsError, match=words):
        read_methods({"methods": methods}, changes)
