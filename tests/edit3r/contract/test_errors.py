"""What errors say."""

import pytest

from edit3r.contract.errors import one_line


@pytest.mark.parametrize(
    ("error", "clause"),
    [
        (ValueError("two\n  lines."), "two lines"),
        (KeyError(), "KeyError"),
        (RuntimeError("long " * 9), "long long"),
        ("a reason...", "a reason"),
    ],
)
def test_what_a_library_says_becomes_a_clause_of_one_line(error, clause):
    assert one_line(error, 9 if "long" in str(error) else 300) == clause
