"""Forms from settings schemas, and back."""

import re

import pytest
from edit3r_app import forms
from edit3r_app.draft import Draft, Step
from edit3r_app.forms import (
    CHOSEN,
    NOT_IN_FORM,
    form_lines,
    offered,
    run_settings,
    set_by_hand,
    settings_form,
)

from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import is_user_only
from edit3r.loading.describe import SettingLine
from edit3r.loading.registry import default_registry
from edit3r.running.config import RunConfig, make_run_config

REGISTRY = default_registry()


def fields_of(form=None):
    groups = settings_form(Draft(form=form or {}), REGISTRY)
    return {
        (one["group"], field["name"]): field
        for one in groups
        for field in one["fields"]
    }


def test_every_setting_of_the_run_is_in_the_dialog_in_plain_words():
    fields = fields_of()
    named = {name for group, name in fields if group == "run"}
    assert named == set(RunConfig.model_fields) - set(NOT_IN_FORM)
    forms = [{kind: name} for kind in CHOSEN for name in offered(REGISTRY, kind)]
    for form in [{}, *forms]:
        for key, field in fields_of(form).items():
            said = f"{field['label']} {field['help']} {field['unit']}"
            assert not re.search(r"--\w|≥|\| |\bnull\b|2\.14748e|docs/", said), (
                key,
                said,
            )


def test_settings_are_switches_selects_sliders_and_numbers():
    fields = fields_of({"editor": "recolor"})
    kinds = {name: field["kind"] for (_, name), field in fields.items()}
    assert (kinds["exposure"], kinds["grid"]) == ("select", "slider")
    assert (kinds["strength"], kinds["frames"]) == ("slider", "number")
    assert fields["run", "seed"]["max"] is None  # no limit that anybody meets
    assert fields["run", "fov"]["unit"] == "degrees"


@pytest.mark.parametrize(
    ("type", "range", "default", "kind", "limits"),
    [
        ("int", "≥ 2, ≤ 1002", 5, "slider", (2, 1002, 1)),
        ("int", "≥ 2, ≤ 1003", 5, "number", (2, 1003, 1)),
        ("int or null", "> 2, < 9", None, "number", (2, 9, 1)),
        ("float", "> 0.5, < 10.5", 1.5, "slider", (0.5, 10.5, 0.01)),
        ("float", "≥ 0.5", 1.5, "number", (0.5, None, 0.01)),
        ("int", "≥ 0, ≤ 1e6", 5, "number", (0, 1e6, 1)),
        ("int", "≥ 0, ≤ 1000001", 5, "number", (0, None, 1)),
    ],
)
def test_a_number_is_a_slider_where_its_steps_are_few(
    type, range, default, kind, limits
):
    field = forms._field(SettingLine("count", type, range, default, "How many."), {})
    assert field["kind"] == kind
    assert tuple(field[name] for name in ("min", "max", "step")) == limits


def test_what_was_set_beside_the_sentence_is_told_in_words():
    told = set_by_hand(
        {"prompt": "x", "guess": True, "fov": 65.0, "editor": {"name": "looks"}}
    )
    assert told == ["Width of the lens: 65.0", "editor: looks"]


def test_settings_that_only_the_user_may_give_are_not_offered():
    for kind in CHOSEN:
        for name in offered(REGISTRY, kind):
            cls = REGISTRY.settings_class(REGISTRY.find(kind, name))
            for line in form_lines(REGISTRY, kind, name):
                assert not is_user_only(cls.model_fields[line.name])
    command = form_lines(REGISTRY, "editor", "command")
    assert "command" not in {line.name for line in command}


def test_what_is_left_alone_is_no_setting_and_what_is_typed_is_read_as_by_set():
    assert "seed" not in run_settings(Draft(form={"prompt": "x"}), REGISTRY)
    typed = {"run": {"seed": "7", "fov": ""}, "editor recolor": {"strength": "0.25"}}
    draft = Draft(form={"prompt": "x", "editor": "recolor", "settings": typed})
    settings = run_settings(draft, REGISTRY)
    assert settings["seed"] == 7
    assert "fov" not in settings
    assert settings["editor"] == {"name": "recolor", "strength": 0.25}


@pytest.mark.parametrize("kind", CHOSEN)
def test_the_forms_of_every_component_left_alone_give_a_run_that_is_valid(kind):
    for name in offered(REGISTRY, kind):
        settings = run_settings(Draft(form={"prompt": "x", kind: name}), REGISTRY)
        assert settings[kind] == {"name": name}


@pytest.mark.parametrize(
    ("form", "sentence"),
    [
        ({"editor": "no-such"}, "cannot be chosen here"),
        ({"editor": "command"}, "cannot be chosen here"),
        ({"reconstructor": "editors:command"}, "cannot be chosen here"),
        (
            {
                "reconstructor": "refit",
                "settings": {"reconstructor refit": {"editor": "command"}},
            },
            "starts a program",
        ),
        (
            {
                "settings": {
                    "run": {
                        "refiners": "[{name: x, editor: {name: 'editors:command'}}]"
                    }
                }
            },
            "starts a program",
        ),
        ({"settings": {"run": {"seed": "-1"}}}, "run.seed"),
        ({"settings": {"run": {"fov": "{"}}}, "fov"),
        (
            {"editor": "recolor", "settings": {"editor recolor": {"strength": "7"}}},
            "editor.strength",
        ),
    ],
)
def test_what_cannot_be_run_is_refused_before_it_is_queued(form, sentence):
    with pytest.raises(SettingsError, match=sentence):
        run_settings(Draft(form={"prompt": "paint it red", **form}), REGISTRY)


def test_a_sentence_may_say_any_word():
    draft = Draft(form={"prompt": "command"})
    assert run_settings(draft, REGISTRY)["prompt"] == "command"


def test_steps_are_settings_of_the_run():
    steps = [
        Step("larger", -1),
        Step("candidate", 2),
        Step("grow", 2.5),
        Step("invert"),
    ]
    config = make_run_config(run_settings(Draft(steps), REGISTRY))
    assert (config.larger, config.candidate) == (-1, 2)
    assert (config.grow, config.invert) == (2.5, True)
    assert "candidate" not in run_settings(Draft([Step("invert")]), REGISTRY)
    # who is asked and takes the first has chosen it: the run does not ask again
    chosen = make_run_config(run_settings(Draft([Step("candidate", 1)]), REGISTRY))
    assert "candidate" in chosen.set_by_the_user()
