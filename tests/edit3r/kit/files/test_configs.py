import pytest

from edit3r.kit.files.configs import MAX_VALUES, parse_yaml


def repeated(times):
    """A list of `times` aliases of a list of 400 numbers."""
    return f"[&a [{', '.join(400 * '1')}]{', *a' * (times - 1)}]"


def test_values_that_aliases_repeat_are_counted_each_time():
    assert len(parse_yaml(repeated(MAX_VALUES // 402))) == MAX_VALUES // 402
    with pytest.raises(ValueError, match="more than 100000 values"):
        parse_yaml(repeated(MAX_VALUES // 400 + 1))
