import pytest

from edit3r.kit.files.names import is_plain_name, unique_names


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("IMG 0001 (2)", "IMG 0001 (2)"),
        ("Müller", "Müller"),
        ("../up", "__up"),
        ("..", "_"),
        ("a/b\\c", "a_b_c"),
        ("a\0b", "a_b"),
        ("", "photo"),
        (".hidden. ", "hidden"),
        ("path_0000", "_path_0000"),
        ("Path_7", "_Path_7"),
        ("nul", "_nul"),
        ("COM1.left", "_COM1.left"),
        (b"caf\xe9".decode("utf-8", "surrogateescape"), "caf_"),
        ("x" * 240, "x" * 100),
    ],
)
def test_a_name_becomes_one_that_every_file_system_takes(name, safe):
    assert unique_names([name]) == [safe]


def test_names_stay_apart_whatever_was_changed():
    given = [
        "a/b",
        "a_b",
        "A_B",
        "x" * 240,
        "x" * 241,
        "a_b-1",
        "photo",
        "",
        "é" * 300,
        "é" * 301,
        "\U0001f600" * 99,
    ]
    names = unique_names(given)
    assert len({name.casefold() for name in names}) == len(given)
    assert names[5] == "a_b-1" and names[:3] == ["a_b-2", "a_b-3", "A_B-4"]
    assert all(0 < len(name) <= 100 and len(name.encode()) <= 200 for name in names)


def test_no_name_is_shown_in_another_order_than_it_has():
    name = "photo\u202egpj.exe"
    assert unique_names([name]) == ["photo_gpj.exe"] and not is_plain_name(name)
