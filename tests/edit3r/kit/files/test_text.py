"""Text and JSON of strangers: within bounds, or one reason."""

import json
import os

import pytest

from edit3r.kit.files.text import parse_json, read_json, read_plain


def test_text_comes_from_files_alone_and_a_pipe_is_told_at_once(tmp_path):
    (tmp_path / "a.json").write_text("\u0444", "utf-8")
    assert read_plain(tmp_path / "a.json") == "\u0444"
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.json")
    for name in ("pipe.json", "none.json", "."):
        with pytest.raises(OSError, match="no such file"):
            read_plain(tmp_path / name)


GOOD = {
    '{"a": [1, "b", null]}': {"a": [1, "b", None]},
    b"\xef\xbb\xbf{}": {},
    '"\\ud83d\\ude00"': "\U0001f600",  # a whole pair
    '"\\\\ud800"': "\\ud800",  # a backslash and letters
    "[]": [],
    '"\u00e9"'.encode("utf-16"): "\u00e9",
}


@pytest.mark.parametrize(("text", "tree"), GOOD.items())
def test_json_is_read(text, tree):
    assert parse_json(text) == tree


BAD = {
    "deep": "[" * 200_000,
    "deep objects": '{"a":' * 100_000,
    "NaN": '{"a": NaN}',
    "infinite": "[-Infinity]",
    "half a character": '{"a": "\\ud800"}',
    "as a key": '{"\\udfff": 1}',
    "in capitals": '"\\uDC00"',
    "two halves the wrong way": '"\\ude00\\ud83d"',
    "no UTF-8": b"\xff\xfe\xfd{",
    "nothing": "",
    "words": "hello",
    "cut off": '{"a": [1, ',
    "too large": "1e400",
    "very long number": "1" * 5000,
}


@pytest.mark.parametrize("text", BAD.values(), ids=BAD)
def test_what_is_no_json_is_one_reason(text, tmp_path):
    with pytest.raises(ValueError):
        parse_json(text)
    (tmp_path / "a").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError):
        read_json(tmp_path / "a")


def test_a_key_twice_in_one_object_is_refused_with_its_line():
    assert parse_json('[{"a": 1}, {"a": 2}]') == [{"a": 1}, {"a": 2}]
    with pytest.raises(ValueError, match=r"'size' stands twice .*line 3"):
        parse_json('{"size": 1,\n "seed": 2,\n "size": 3}')


def test_a_pipe_is_no_file(tmp_path):
    import os

    os.mkfifo(tmp_path / "a")
    with pytest.raises(OSError):
        read_json(tmp_path / "a")


def test_what_is_written_comes_back():
    tree = {"a": [1.5, "\u00e9\U0001f600", {"b": None}]}
    assert parse_json(json.dumps(tree)) == tree
