"""Look-up, clashes and building, on a registry made by hand: no installed plugin is involved."""

import sys
from types import ModuleType

import pytest
from pydantic import Field

from edit3r.contract.component import Component, Offer
from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    PluginError,
    SettingsError,
    UnknownComponentError,
)
from edit3r.contract.settings import PartChoice, Settings
from edit3r.loading.load import LoadedPlugins, PluginFailure
from edit3r.loading.registry import Registry, default_registry, install_hint

MODULE = "classes_of_test_registry"


class Plain:
    class Settings(Settings):
        size: int = Field(3, ge=1, le=9, description="size")

    def __init__(self, settings):
        self.given = settings


class Whole:
    class Settings(Settings):
        backbone: PartChoice = Field(
            PartChoice(name="plain", settings={"size": 4}), description="part"
        )
        head: PartChoice = Field(PartChoice(name="topped"), description="part")

    def __init__(self, settings, backbone, head):
        self.backbone, self.head = backbone, head


class Topped:
    class Settings(Settings):
        pass

    def __init__(self, settings, backbone):
        self.backbone = backbone


class Bare:
    def __init__(self, settings):
        pass


class Greedy:
    def __init__(self):
        pass


class Failing:
    def __init__(self, settings):
        raise RuntimeError("no weights here")


class Refusing:
    def __init__(self, settings):
        raise InputError("give a folder.")


class Exhausted:
    def __init__(self, settings):
        raise RuntimeError("CUDA out of memory")


class WrongSettings:
    class Settings:
        pass


@pytest.fixture
def registry(monkeypatch):
    module = ModuleType(MODULE)
    for cls in (
        Plain,
        Whole,
        Topped,
        Bare,
        Greedy,
        Failing,
        Refusing,
        Exhausted,
        WrongSettings,
    ):
        setattr(module, cls.__name__, cls)
    monkeypatch.setitem(sys.modules, MODULE, module)

    def offer(kind, name, cls, plugin="ours", **more):
        return Offer(
            kind, Component(name, f"{MODULE}:{cls}", "", **more), plugin, "1.0"
        )

    offers = (
        offer("editor", "plain", "Plain"),
        offer("editor", "twin", "Plain", plugin="first"),
        offer("editor", "twin", "Bare", plugin="second"),
        offer("editor", "bare", "Bare"),
        offer("editor", "greedy", "Greedy"),
        offer("editor", "failing", "Failing"),
        offer("editor", "refusing", "Refusing"),
        offer("editor", "exhausted", "Exhausted"),
        offer("editor", "wrong-settings", "WrongSettings"),
        offer("editor", "absent", "NotThere"),
        offer(
            "editor", "needy", "Plain", requires=("surely_not_there",), extra="needy"
        ),
        offer("backbone", "plain", "Plain"),
        offer("head", "topped", "Topped", parts=("backbone",)),
        offer("reconstructor", "whole", "Whole", parts=("backbone", "head")),
        offer("reconstructor", "partless", "Bare", parts=("backbone",)),
    )
    return Registry(
        LoadedPlugins(offers, (PluginFailure("broken", "0.1", "it fell over"),))
    )


def test_offers_are_sorted_and_chosen_by_kind(registry):
    names = [offer.component.name for offer in registry.offers("editor")]
    assert names == sorted(names)
    assert {offer.kind for offer in registry.offers()} == {
        "editor",
        "backbone",
        "head",
        "reconstructor",
    }


def test_an_unknown_name_says_what_was_meant_what_there_is_and_what_failed(registry):
    with pytest.raises(UnknownComponentError) as error:
        registry.find("editor", "plane")
    text = str(error.value)
    assert "no editor named 'plane'. Did you mean 'plain'?" in text
    assert "Installed: absent, bare" in text
    assert "Plugin 'broken' did not load: it fell over." in text


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import nothing_of_that_name", "No module named"),
        ("def (:", "invalid syntax"),
        ("import sys; sys.exit(3)", "exit"),
        ("x = 1", "offers nothing"),
    ],
)
def test_a_named_plugin_that_does_not_load_is_warned_of(tmp_path, code, reason):
    file = tmp_path / f"broken_{abs(hash(code))}.py"
    file.write_text(code)
    with pytest.warns(UserWarning, match=f"--plugin .* did not load.*{reason}"):
        default_registry((str(file),))


def test_an_unknown_kind_says_which_there_are(registry):
    with pytest.raises(
        UnknownComponentError, match=r"no kind 'editors'\. Did you mean 'editor'\?"
    ):
        registry.find("editors", "plain")


def test_a_name_offered_twice_is_an_error_naming_both_and_works_when_qualified(
    registry,
):
    with pytest.raises(UnknownComponentError, match="'first:twin' or 'second:twin'"):
        registry.build("editor", "twin")
    assert isinstance(registry.build("editor", "first:twin"), Plain)
    assert isinstance(registry.build("editor", "second:twin"), Bare)
    (clash,) = registry.clashes()
    assert "is offered by first and second; ask for first:" in clash


def test_one_name_in_two_kinds_is_no_clash(registry):
    assert registry.find("editor", "plain").kind == "editor"
    assert registry.find("backbone", "plain").kind == "backbone"


def test_what_is_built_carries_its_settings_and_its_offer(registry):
    built = registry.build("editor", "plain", size=5)
    assert built.settings.size == built.given.size == 5
    assert built.offer.qualified_name == "ours:plain"


def test_a_component_without_settings_refuses_any(registry):
    assert registry.build("editor", "bare").settings == Settings()
    with pytest.raises(
        SettingsError,
        match=r"editor.size: unknown setting. Known settings of editor: none.",
    ):
        registry.build("editor", "bare", size=5)


@pytest.mark.parametrize(
    "values, sentence",
    [
        ({"size": 10}, "editor.size: input should be less than or equal to 9, got 10."),
        (
            {"siez": 5},
            "editor.siez: unknown setting. Did you mean 'size'? Known settings of editor: size.",
        ),
        ({"size": "x"}, "editor.size: input should be a valid integer"),
    ],
)
def test_wrong_settings_are_named_with_their_key(registry, values, sentence):
    with pytest.raises(SettingsError) as error:
        registry.build("editor", "plain", **values)
    assert str(error.value).startswith(sentence)


def test_parts_are_built_first_and_shared_between_siblings(registry):
    whole = registry.build("reconstructor", "whole")
    assert isinstance(whole.backbone, Plain)
    assert whole.head.backbone is whole.backbone


def test_settings_of_a_part_keep_the_default_part_and_its_other_settings(registry):
    assert registry.build("reconstructor", "whole").backbone.settings.size == 4
    whole = registry.build("reconstructor", "whole", backbone={"size": 7})
    assert isinstance(whole.backbone, Plain) and whole.backbone.settings.size == 7


def test_a_wrong_setting_of_a_part_is_named_by_its_whole_key(registry):
    with pytest.raises(SettingsError, match=r"^reconstructor\.backbone\.size: "):
        registry.build("reconstructor", "whole", backbone={"size": 70})


def test_a_built_part_is_used_as_it_is(registry):
    mine = registry.build("backbone", "plain", size=1)
    assert (
        registry.build("reconstructor", "whole", parts={"backbone": mine}).backbone
        is mine
    )


def test_a_part_that_nobody_names_is_an_error(registry):
    with pytest.raises(
        PluginError,
        match="needs a backbone; neither its settings nor the caller name one",
    ):
        registry.build("reconstructor", "partless")


def test_what_is_not_installed_is_told_with_the_command_that_installs_it(registry):
    offer = registry.find("editor", "needy")
    assert registry.missing(offer) == ("surely_not_there",)
    with pytest.raises(
        MissingDependencyError,
        match=r'needs surely_not_there; install with: pip install "edit3r\[needy\]"',
    ):
        registry.build("editor", "needy")


def test_the_hint_of_a_third_party_extra_names_its_own_package():
    offer = Offer(
        "editor",
        Component("a", "m:C", "", requires=("x",), extra="edit3r-sepia[gpu]"),
        "sepia",
        "1",
    )
    assert install_hint(offer) == "install with: pip install 'edit3r-sepia[gpu]'"


@pytest.mark.parametrize(
    "name, sentence",
    [
        (
            "absent",
            "could not be imported from 'classes_of_test_registry:NotThere' (AttributeError",
        ),
        ("greedy", "could not be constructed as Greedy(settings) (TypeError"),
        (
            "failing",
            "could not be constructed as Failing(settings) (RuntimeError: no weights here)",
        ),
        ("wrong-settings", "its Settings must subclass edit3r.Settings"),
    ],
)
def test_a_component_that_breaks_while_building_is_named(registry, name, sentence):
    with pytest.raises(PluginError) as error:
        registry.build("editor", name)
    assert sentence in str(error.value) and repr(name) in str(error.value)


def test_a_package_that_is_needed_but_not_declared_is_named(registry, monkeypatch):
    offer = Offer(
        "editor",
        Component("undeclared", "surely_not_there.editor:E", ""),
        "ours",
        "1.0",
    )
    monkeypatch.setattr(registry, "plugins", LoadedPlugins((offer,), ()))
    with pytest.raises(
        PluginError,
        match="Install 'surely_not_there'; the plugin should list it in requires",
    ):
        registry.build("editor", "undeclared")


def test_a_component_s_own_sentence_for_the_user_passes_unchanged(registry):
    with pytest.raises(InputError, match=r"^give a folder\.$"):
        registry.build("editor", "refusing")


def test_running_out_of_memory_is_not_the_plugin_s_fault(registry):
    with pytest.raises(RuntimeError, match="out of memory"):
        registry.build("editor", "exhausted")


@pytest.mark.parametrize("name", ["kind", "name", "parts", "self", "registry"])
def test_a_setting_may_have_any_name_and_an_unknown_one_is_said(name):
    with pytest.raises(SettingsError, match=f"editor.{name}: unknown setting"):
        default_registry().build_choice(
            "editor", PartChoice(name="none", settings={name: 1})
        )
