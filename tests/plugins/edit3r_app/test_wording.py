"""What the page says never speaks of a command line."""

import pytest
from edit3r_app.wording import COMMAND, NOTHING_LEFT, in_app

from edit3r import default_registry


@pytest.mark.parametrize(
    ("told", "shown"),
    [
        (
            "'cup' is not known; click on it, or draw a box, use a segmenter that reads words "
            "(edit3r list-plugins --kind segmenter), or add --guess to take what stands out.",
            "'cup' is not known; click on it, or draw a box, use a segmenter that reads words.",
        ),
        (
            "To correct it, take --candidate 2 or --candidate 3, or click on it.",
            "To correct it, click on it.",
        ),
        (
            "it has that of the first (--exposure own keeps each)",
            "it has that of the first",
        ),
        (
            "pip install edit3r again. The photos do not overlap.",
            "The photos do not overlap.",
        ),
        ("leave out --strict.", NOTHING_LEFT),
        ("add photos taken from other places.", "add photos taken from other places."),
        ("", ""),
    ],
)
def test_clauses_for_the_command_line_are_left_out(told, shown):
    assert in_app(told) == shown


def test_every_command_is_known_for_one():
    for offer in default_registry().offers("command"):
        told = f"It is refused; see edit3r {offer.component.name}."
        assert not COMMAND.search(in_app(told)), offer.component.name
