import pytest
from hypothesis import given, strategies as st
from pydantic import Field

from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.settings import (
    USER_ONLY,
    PartChoice,
    Settings,
    make_settings,
    merge,
    of_file,
)
from edit3r.kit.files.configs import find_config, parse_assignments, read_yaml


def test_assignments_nest_by_dots_and_values_are_yaml():
    words = "editor.strength=0.5 editor.on=true a.b.c=[1,2] name=plain"
    assert parse_assignments([*words.split(), "seed = 3"]) == {
        "editor": {"strength": 0.5, "on": True},
        "a": {"b": {"c": [1, 2]}},
        "name": "plain",
        "seed": 3,
    }


def test_text_that_is_no_yaml_stays_text():
    assert parse_assignments(["editor.command=run: {in"]) == {
        "editor": {"command": "run: {in"}
    }


@pytest.mark.parametrize("wrong", ["editor.strength", "=3", "editor..x=1", ".a=1", ""])
def test_a_wrong_assignment_shows_a_right_one(wrong):
    with pytest.raises(SettingsError, match="expected KEY=VALUE, for example --set"):
        parse_assignments([wrong])


def doubling(first, next_one):
    """A list of 60 values, each of which holds the one before twice."""
    values = [f"&v0 {first}"]
    values += [f"&v{n} {next_one.format(n - 1)}" for n in range(1, 60)]
    return f"[{', '.join(values)}]"


HOSTILE = {
    "aliases of aliases": doubling("[x]", "[*v{0}, *v{0}]"),
    "merged aliases": doubling("{a: 1}", "{{<<: [*v{0}, *v{0}]}}"),
    "a list of itself": "&a [*a]",
    "a number too long": "9" * 5000,
    "too deep": "[" * 5000,
    "a number as key": "{1: 2}",
    "nothing as key": "{null: 2}",
    "a list as key": "{[1]: 2}",
}


@pytest.mark.slow
@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_what_python_cannot_hold_is_refused_in_a_file_and_text_in_an_assignment(
    content, tmp_path
):
    file = tmp_path / "run.yaml"
    file.write_text(f"editor: {content}")
    with pytest.raises(InputError, match=r"run.yaml: not valid YAML \("):
        read_yaml(file)
    assert parse_assignments([f"editor.x={content}"]) == {"editor": {"x": content}}


def test_aliases_and_merges_of_a_usual_size_are_read(tmp_path):
    file = tmp_path / "run.yaml"
    file.write_text("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: [*a, *a]")
    one = {"x": 1}
    assert read_yaml(file) == {"a": one, "b": {"x": 1, "y": 2}, "c": [one, one]}


def test_a_long_value_is_not_repeated_whole_in_the_error():
    class Sizes(Settings):
        size: int = Field(1, description="size")

    with pytest.raises(SettingsError) as error:
        make_settings(Sizes, {"size": "x" * 10_000}, where="run")
    assert len(str(error.value)) < 400


class Programs(Settings):
    one: str = Field("", json_schema_extra=USER_ONLY)
    some: list[str] = Field([], json_schema_extra=USER_ONLY)


@pytest.mark.parametrize("values", [{"one": "mark"}, {"some": ["mark"]}])
def test_a_program_is_named_by_the_user_alone_in_lists_too(values):
    made = make_settings(Programs, values, "editor")
    assert made.model_dump(exclude_defaults=True) == values
    with pytest.raises(SettingsError, match="a file may not give this setting"):
        make_settings(Programs, of_file(values), "editor")
    nothing = {name: type(value)() for name, value in values.items()}
    make_settings(Programs, of_file(nothing), "editor")


def test_later_layers_replace_leaves_and_keep_the_rest():
    assert merge({"a": {"x": 1, "y": 2}, "b": 3}, {"a": {"y": 5}}) == {
        "a": {"x": 1, "y": 5},
        "b": 3,
    }


def test_another_name_replaces_the_settings_of_the_one_before():
    before = {"head": {"name": "small", "width": 8}}
    assert merge(before, {"head": {"name": "small", "seed": 1}}) == {
        "head": {"name": "small", "width": 8, "seed": 1}
    }
    other = {"head": {"name": "large", "seed": 1}}
    assert merge(before, other) == other


def test_settings_after_a_name_keep_the_name():
    assert parse_assignments(["editor=sepia", "editor.strength=1"]) == {
        "editor": {"name": "sepia", "strength": 1}
    }


def test_a_name_after_settings_replaces_them_they_were_another_component_s():
    assert parse_assignments(["editor.strength=1", "editor=sepia"]) == {
        "editor": "sepia"
    }


trees = st.recursive(
    st.integers(),
    lambda inner: st.dictionaries(st.sampled_from("abc"), inner),
    max_leaves=8,
)


@given(
    st.dictionaries(st.sampled_from("abc"), trees),
    st.dictionaries(st.sampled_from("abc"), trees),
)
def test_merging_changes_neither_input_and_is_idempotent(base, over):
    before = repr(base), repr(over)
    merged = merge(base, over)
    assert (repr(base), repr(over)) == before
    assert merge(merged, over) == merged


@pytest.mark.parametrize(
    ("given", "settings"),
    [("vit", {}), ({"name": "vit"}, {}), ({"name": "vit", "width": 8}, {"width": 8})],
)
def test_a_part_is_given_by_its_name_with_settings_beside_it(given, settings):
    choice = PartChoice.model_validate(given)
    assert choice == PartChoice(name="vit", settings=settings)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"a: [1", "not valid YAML"),
        (b"\xff\xfe\x00", "not valid YAML"),
        (b"- 1\n- 2", "expected a mapping of settings at the top, got list"),
        (b"just text", "got str"),
    ],
)
def test_a_configuration_file_that_cannot_be_used_is_named(tmp_path, content, sentence):
    file = tmp_path / "c.yaml"
    file.write_bytes(content)
    with pytest.raises(InputError, match=rf"c\.yaml: .*{sentence}"):
        read_yaml(file)


def test_an_empty_file_is_an_empty_mapping(tmp_path):
    file = tmp_path / "c.yaml"
    file.write_text("# nothing yet\n")
    assert read_yaml(file) == {}


def test_a_file_given_by_path_is_found_and_an_unknown_name_is_not(tmp_path):
    file = tmp_path / "c.yaml"
    file.write_text("seed: 1")
    assert find_config(str(file)) == file
    with pytest.raises(InputError, match="neither a file nor a shipped configuration"):
        find_config("surely-not-there")
