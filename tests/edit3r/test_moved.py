"""Names that were promised elsewhere are still found there, with a warning."""

import importlib
import sys

import pytest
from edit3r_language.things import read_thing

from edit3r import moved
from edit3r.contract.errors import InputError
from edit3r.kit.compute.colour_names import read_colour
from edit3r.kit.files.configs import parse_assignments
from edit3r.kit.geometry.cameras import project
from edit3r.running.reading import read
from edit3r.running.selecting.select import select_masks


@pytest.mark.parametrize(
    ("old", "name", "there"),
    [
        ("edit3r.errors", "InputError", InputError),
        ("edit3r.config", "parse_assignments", parse_assignments),
        ("edit3r.geometry.cameras", "project", project),
        ("edit3r.selection.select", "select_masks", select_masks),
        ("edit3r.kit.wishes.read", "read", read),
        ("edit3r.kit.wishes.colours", "read_colour", read_colour),
        ("edit3r.kit.wishes.things", "read_thing", read_thing),
    ],
)
def test_an_old_module_gives_the_same_thing_and_says_where_it_is(old, name, there):
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match=there.__module__):
        module = importlib.import_module(old)
    assert getattr(module, name) is there


@pytest.mark.parametrize("old", moved.MOVED)
def test_an_old_module_has_no_other_names(old):
    with pytest.warns(DeprecationWarning):
        sys.modules.pop(old, None)
        module = importlib.import_module(old)
    with pytest.raises(AttributeError, match="never_there"):
        module.never_there  # noqa: B018


def test_a_module_that_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("edit3r.geometry.never_there")
