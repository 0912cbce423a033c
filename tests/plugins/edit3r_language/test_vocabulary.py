"""The words of the grammar, and the files that list them."""

import pytest
from edit3r_language import vocabulary


def test_a_set_that_stands_twice_in_the_vocabulary_is_named(monkeypatch):
    lines = ["less: a", "more: b", "less: c"]
    monkeypatch.setattr(vocabulary, "_lines", lambda name: lines)
    with pytest.raises(ValueError, match="'less' stands there twice"):
        vocabulary.WordSets.read()
