"""What is refused, told from undo, or suggested; which sentence means what: `test_sentences`."""

import time
from contextlib import suppress

import pytest
from edit3r_language.grammar import GrammarReader
from hypothesis import given, settings, strategies as st

from edit3r.contract.errors import PromptError

read = GrammarReader().read


@pytest.mark.parametrize("sentence", ["paint the bike", "make it", "the bike"])
def test_no_word_is_to_blame_where_the_change_is_not_said(sentence):
    (instruction,) = read(sentence)
    assert (instruction.action, instruction.unread) == ("other", ())


@pytest.mark.parametrize(
    "sentence",
    ["", "  ", "???", "\x00\x07", "keep everything unchanged", "no changes please"],
)
def test_a_sentence_that_asks_for_nothing_is_refused(sentence):
    with pytest.raises(PromptError):
        read(sentence)


def test_two_colours_on_one_thing_are_refused():
    with pytest.raises(PromptError, match="two colours at once"):
        read("paint the bike red and blue")


@pytest.mark.parametrize(
    ("sentence", "rest"),
    [
        ("undo", ""),
        ("undo that and make its plaque purple", "make its plaque purple"),
        ("undo, then paint it blue", "paint it blue"),
        ("revert the sky to blue", None),
        ("Undo the last edit, then paint it red", "paint it red"),
        ("make it red", None),
    ],
)
def test_undo_is_told_from_what_else_is_asked(sentence, rest):
    assert GrammarReader().after_undo(sentence) == rest


def test_a_misspelt_colour_is_suggested():
    (instruction,) = read("paint the bike purpel")
    assert "Did you mean 'purple'" in GrammarReader().hint(instruction)


def test_a_short_word_is_named_without_words_of_nearly_its_spelling():
    (instruction,) = read("make the sky pop")
    assert instruction.unread == ("pop",)
    assert "Did you mean" not in GrammarReader().hint(instruction)


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("fxo", " Did you mean 'fox'?"),
        ("hosue", " Did you mean 'house'?"),
        ("motorcyle", " Did you mean 'motorcycle'?"),
        ("fax", ""),  # another word, not a slip
        ("gazebo", ""),
        ("ladder", ""),
    ],
)
def test_a_misspelt_thing_is_suggested_and_no_thing_of_another_name(word, meant):
    (instruction,) = read(f"paint the {word} red")
    assert GrammarReader().hint(instruction) == meant


TEXT = (
    "paint make turn the bike wall red light blue darker warmer more less it everything and , not "
    "background very from to except but all apart rest remove keep don't only parts left cup of in "
    "as like winter with a"
)
WORDS = TEXT.split()


@pytest.mark.parametrize("text", ["from red", "FROM%RED", "instead of green"])
def test_a_colour_to_change_from_alone_is_told_and_not_done(text):
    """Once an IndexError, found by the next test."""
    (instruction,) = read(text)
    assert instruction.action == "other"
    assert instruction.unread


@pytest.mark.slow
@settings(max_examples=300)
@given(
    st.one_of(
        st.text(max_size=40),
        st.lists(st.sampled_from(WORDS), max_size=12).map(" ".join),
    )
)
def test_any_text_is_read_or_refused(text):
    try:
        instructions = read(text)
    except PromptError:
        return
    assert instructions
    for instruction in instructions:
        assert instruction.action in ("paint", "look", "remove", "other")
        assert (instruction.action == "paint") == bool(instruction.changes)
        assert (instruction.action == "look") == bool(instruction.look)
        assert str(instruction)


@pytest.mark.parametrize(
    "text", ["paint the bike red " * 500, "a," * 5000, "red" * 3000]
)
def test_long_sentences_are_read_quickly(text):
    started = time.process_time()
    with suppress(PromptError):
        read(text[:10_000])
    assert time.process_time() - started < 0.2
