"""Forms from settings schemas, and back."""

from typing import Literal

import pytest
from edit3r_app.forms import CHOSEN, form_fields, offered, read_form, run_settings
from pydantic import Field

from edit3r.config import PartChoice, Settings
from edit3r.errors import SettingsError
from edit3r.plugins.registry import default_registry

REGISTRY = default_registry()


class Some(Settings):
    flag: bool = Field(True, description="a flag")
    way: Literal["a", "b"] | None = Field(None, description="a way")
    amount: float = Field(0.5, ge=0, le=1, description="an amount")
    place: tuple[float, float] | None = Field(None, description="a place")
    text: str = Field("", description="a text")
    matcher: PartChoice = Field(PartChoice(name="classical"), description="a part")


def test_every_setting_gets_a_field_with_its_description_range_and_default():
    fields = {field.name: field for field in form_fields(Some, REGISTRY)}
    assert [fields[name].form for name in Some.model_fields] == [
        "switch",
        "choice",
        "text",
        "text",
        "text",
        "choice",
    ]
    assert (
        fields["way"].choices == ("", "a", "b")
        and fields["amount"].hint == "float, ≥ 0, ≤ 1"
    )
    assert fields["amount"].label == "an amount" and fields["amount"].default == "0.5"
    assert "classical" in fields["matcher"].choices


def test_only_what_differs_from_the_defaults_becomes_a_setting():
    fields = form_fields(Some, REGISTRY)
    assert read_form(fields, {"flag": True, "amount": "0.5", "way": ""}) == {}
    typed = {
        "flag": False,
        "amount": "0.25",
        "way": "b",
        "place": "[0.1, 0.2]",
        "text": "12",
        "matcher": "posed",
    }
    read = read_form(fields, typed)
    assert read == {
        "flag": False,
        "amount": 0.25,
        "way": "b",
        "place": [0.1, 0.2],
        "text": "12",
        "matcher": "posed",
    }
    assert Some(**read).matcher.name == "posed"


@pytest.mark.parametrize("kind", CHOSEN)
def test_the_forms_of_every_component_left_alone_give_a_run_that_is_valid(kind):
    for name in offered(REGISTRY, kind):
        settings = run_settings({"prompt": "x", kind: name}, REGISTRY)
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
            "starts programs",
        ),
        (
            {
                "settings": {
                    "run": {
                        "refiners": "[{name: x, editor: {name: 'editors:command'}}]"
                    }
                }
            },
            "starts programs",
        ),
        ({"settings": {"run": {"seed": "-1"}}}, "run.seed"),
        ({"settings": {"run": {"fov": "{"}}}, "fov"),
        ({"settings": {"editor recolor": {"strength": "7"}}}, "editor.strength"),
    ],
)
def test_what_cannot_be_run_is_refused_before_it_is_queued(form, sentence):
    with pytest.raises(SettingsError, match=sentence):
        run_settings({"prompt": "paint it red", **form}, REGISTRY)


def test_a_wish_may_say_any_word():
    assert run_settings({"prompt": "command"}, REGISTRY)["prompt"] == "command"
