import pytest

from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import Settings, make_settings
from edit3r.kit.files.configs import MAX_VALUES, parse_assignments, parse_yaml


class Typed(Settings):
    text: str = ""
    whole: int = 0
    number: float = 0.0
    switch: bool = False
    pair: tuple[int, ...] = ()


def typed(key, text):
    values = parse_assignments([f"{key}={text}"])
    return getattr(make_settings(Typed, values, "typed"), key)


@pytest.mark.parametrize(
    "text",
    [
        "tint.py {input} {output} --colour #ff8800",
        "#ff8800",
        "door: the left one",
        "'quoted'",
        "- dash",
        "010",
        "1:05",
        "1_000",
        "yes",
        "2024-01-01",
        "&a name",
        "[the bike] red",
        "",
    ],
)
def test_a_text_setting_is_taken_as_typed(text):
    assert typed("text", text) == text


def test_what_else_was_typed_is_what_the_type_of_its_setting_says():
    assert typed("whole", "010") == 10 and typed("number", "1e-3") == 1e-3
    assert typed("switch", "yes") is True and typed("pair", "[1, 2]") == (1, 2)
    for key, text in (("number", "1:05"), ("whole", "5 # five"), ("pair", "[1] # x")):
        with pytest.raises(SettingsError, match=f"typed.{key}: .*{text[-3:]}"):
            typed(key, text)


def test_yaml_makes_no_number_of_a_text():
    content = "a: 010\nb: 1:05\nc: no\nd: 2024-01-01\ne: 1_000\nf: 1.5\ng: -3\nh:"
    texts = {"a": "010", "b": "1:05", "c": "no", "d": "2024-01-01", "e": "1_000"}
    assert parse_yaml(content) == {**texts, "f": 1.5, "g": -3, "h": None}


@pytest.mark.parametrize(
    "content", ["size: 96\nseed: 3\nsize: 128", "{size: 1,\n\nsize: 2}"]
)
def test_a_key_that_stands_twice_is_refused_with_both_lines(content):
    with pytest.raises(ValueError, match="line 3: the key 'size' stands in line 1 too"):
        parse_yaml(content)
    merged = "a: &a {b: 1}\nc:\n  <<: *a\n  b: 2"
    assert parse_yaml(merged)["c"] == {"b": 2}


def repeated(times):
    """A list of `times` aliases of a list of 400 numbers."""
    return f"[&a [{', '.join(400 * '1')}]{', *a' * (times - 1)}]"


def test_values_that_aliases_repeat_are_counted_each_time():
    assert len(parse_yaml(repeated(MAX_VALUES // 402))) == MAX_VALUES // 402
    with pytest.raises(ValueError, match="more than 100000 values"):
        parse_yaml(repeated(MAX_VALUES // 400 + 1))
