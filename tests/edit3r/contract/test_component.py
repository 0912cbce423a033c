import pytest

from edit3r import Component
from edit3r.contract import hookspecs
from edit3r.contract.component import KINDS, hook_name
from edit3r.contract.interfaces import INTERFACES


@pytest.mark.parametrize("name", ["sepia", "warm-light", "flux2", "a_b", "3d"])
def test_sensible_names_are_accepted(name):
    assert Component(name, "module:Class", "").name == name


@pytest.mark.parametrize(
    "name", ["", "Sepia", "a b", "-a", "a-", "a--b", "a:b", "é", "a/b", None, 3]
)
def test_names_that_could_not_be_typed_or_qualified_are_refused(name):
    with pytest.raises(ValueError, match="lower-case letters"):
        Component(name, "module:Class", "")


@pytest.mark.parametrize("target", ["module", "module:", ":Class", "a:b:c", None])
def test_a_target_reads_module_colon_class(target):
    with pytest.raises(ValueError, match="'module:Class'"):
        Component("a", target, "")


def test_a_lone_text_is_not_read_letter_by_letter():
    with pytest.raises(ValueError, match="requires must be a tuple of names"):
        Component("a", "m:C", "", requires="torch")


def test_lists_become_tuples_so_that_a_component_can_be_a_key():
    component = Component("a", "m:C", "", requires=["x"], parts=["head"])
    assert {component: 1}[component] == 1
    assert component.requires == ("x",)


def test_unknown_parts_are_refused_with_the_kinds():
    with pytest.raises(ValueError, match="unknown part kind 'heads'; kinds are reader"):
        Component("a", "m:C", "", parts=("heads",))


@pytest.mark.parametrize(
    "limits", [{"min_views": 0}, {"max_views": 0}, {"min_views": "2"}]
)
def test_view_limits_are_positive_numbers(limits):
    with pytest.raises(ValueError, match="min_views and max_views"):
        Component("a", "m:C", "", **limits)


def test_every_kind_has_one_hook_and_one_interface():
    hooks = {name for name in vars(hookspecs) if name.startswith("register_")}
    assert hooks == {hook_name(kind) for kind in KINDS}
    assert set(INTERFACES) == set(KINDS)


def test_a_writers_file_is_named_after_the_scene_beside_which_it_lies():
    plain = Component("a", "m:C", "", suffix=".v4.spz")
    assert plain.file_name() == "scene.v4.spz"
    assert plain.file_name("bike") == "bike.v4.spz" and not plain.makes_folder
    page = Component("a", "m:C", "", suffix=".html", stem="viewer")
    assert page.file_name() == "viewer.html"
    assert page.file_name("bike") == "bike-viewer.html"
    assert Component("a", "m:C", "", suffix="-colmap").makes_folder


@pytest.mark.parametrize("name", [{"suffix": "/../x.spz"}, {"stem": "a\\b"}])
def test_a_writers_file_lies_in_no_other_folder(name):
    with pytest.raises(ValueError, match="parts of a file's name"):
        Component("a", "m:C", "", **name)
