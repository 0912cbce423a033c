"""Sentences as people write them: each is read right, or refused in words; none is half done."""

import time
from contextlib import suppress

import pytest
from edit3r_language.grammar import GrammarReader
from hypothesis import given, settings, strategies as st

from edit3r.contract.errors import PromptError

read = GrammarReader().read

PAINT = {
    "paint the bike red": "bike: red",
    "Paint the bike RED, please!": "bike: red",
    "turn the wall light blue": "wall: light blue",
    "make the red bike blue": "red bike: blue",
    "change the colour of the old chair to dark green": "old chair: dark green",
    "I would like the bear to be gold": "bear: gold",
    "paint it #ff8800": "it: #ff8800",
    "turn the orange blue": "orange: blue",
    "make the sea green": "sea: green",
    "make the motorcycle look like it is made of gold": "motorcycle: gold",
    "turn the statue into marble": "statue: marble",
    "make the frame wooden": "frame: wooden",
    "red": "it: red",
    "change the bear's colour to gold": "bear: gold",
    "recolor the chair in teal": "chair: teal",
    "spray paint both doors green": "both doors: green",
    "the roses yellow": "roses: yellow",
    "can you make the planter red?": "planter: red",
    "make the house a nice warm yellow": "house: yellow",
    "make the motorcycle not red but green": "motorcycle: green",
    "recolour": "it: random colours",
    "I want a purple door": "door: purple",
    "give the statue a bronze finish": "statue: bronze",
    "turn the grey stone into white marble": "grey stone: white marble",
}
ADJUST = {
    "make it warmer": "whole: warmth +1",
    "darken the wall": "wall: brightness -1",
    "a darker sky": "sky: brightness -1",
    "black and white": "whole: greyscale",
    "convert the photo to black-and-white": "whole: greyscale",
    "increase the saturation of the wall": "wall: saturation +1",
    "less contrast": "whole: contrast -1",
    "raise the contrast a little": "whole: contrast +0.5",
    "reduce the saturation by half": "whole: saturation -0.83",
    "a lot brighter": "whole: brightness +1.7",
    "make it more blue": "whole: more blue",
    "make the grass greener": "grass: more green",
    "make it brighter and warmer": "whole: brightness +1, warmth +1",
    "give the picture a sepia tone": "whole: sepia",
    "paint the bike red and make it darker": "bike: red, brightness -1",
}
SEVERAL = {
    "paint the door green and the wall white": "door: green | wall: white",
    "turn the sky pink and the water turquoise": "sky: pink | water: turquoise",
    "paint the door and the wall white": "door: white | wall: white",
    "make the house white, the roof red and the door green": (
        "house: white | roof: red | door: green"
    ),
    "darken the door and the wall": "door: brightness -1 | wall: brightness -1",
    "turn the car blue and the background grey": "car: blue | background without car: grey",
    "make the left and the right cup red": "left cup: red | right cup: red",
    "remove the bin and the bench": "bin: remove | bench: remove",
    "paint the wall white and remove the bin": "wall: white | bin: remove",
    "remove the bin and paint the wall white": "bin: remove | wall: white",
}
PARTS = {
    "make the red parts of the motorcycle blue": "motorcycle where it is red: blue",
    "paint everything on the motorcycle that is red blue": "motorcycle where it is red: blue",
    "only the red parts, please: make them green": "what is red: green",
    "change all the red to blue": "what is red: blue",
    "turn the leaves from green to orange": "leaves where it is green: orange",
    "make the wall white instead of grey": "wall where it is grey: white",
    "replace the red with green": "what is red: green",
    "from red to blue": "what is red: blue",
    "the tank of the motorcycle should be blue": "tank (motorcycle): blue",
    "make the bear's nose red": "nose (bear): red",
    "paint only the tank blue": "tank: blue",
    "paint the whole motorcycle blue, including the tyres": "whole motorcycle: blue",
    "paint the car completely black": "whole car: black",
}
WHICH = {
    "colour the left cup green": "left cup: green",
    "paint the cup on the left green": "left cup: green",
    "paint the vase red on the left": "left vase: red",
    "make the big mug red": "big mug: red",
    "paint all cups red": "all cups: red",
    "remove the red car": "red car: remove",
    "delete the person on the left": "left person: remove",
}
NEGATION = {
    "the background in black and white": "background: greyscale",
    "everything black and white except the fox": "whole without fox: greyscale",
    "keep the fox in colour and make the rest black and white": (
        "background without fox: greyscale"
    ),
    "keep only the fox in colour": "whole without fox: greyscale",
    "paint everything except the bear red": "whole without bear: red",
    "make everything but the bear and the tree darker": (
        "whole without bear without tree: brightness -1"
    ),
    "paint the motorcycle green but not the wheels": "motorcycle without wheels: green",
    "paint the motorcycle green without touching the wheels": (
        "motorcycle without wheels: green"
    ),
    "please don't change the background, just make the bear gold": "bear: gold",
    "paint the bike red, keep everything else unchanged": "bike: red",
    "black & white, but the tank stays red": "whole without tank: greyscale",
    "darken everything around the bear": "whole without bear: brightness -1",
    "paint the wall red and leave the bear untouched": "wall without bear: red",
}
LOOK = {
    "as a pencil sketch": "whole: pencil sketch",
    "as if it were drawn with charcoal": "it: charcoal",
    "a pencil drawing of the street": "whole: pencil",
    "turn the whole scene into a cartoon": "whole: cartoon",
    "make it look like winter": "whole: winter",
    "make it look like it's night": "whole: night",
    "give it a vintage look": "whole: vintage",
    "the fox as a pencil sketch": "fox: pencil sketch",
    "turn the background into a pencil sketch": "background: pencil",
    "pencil sketch of everything except the fox": "whole without fox: pencil",
}
REMOVE = {
    "remove the bear": "bear: remove",
    "take the magazine away": "magazine: remove",
    "remove the magazine from the table": "magazine (table): remove",
    "get rid of the car in the background": "background car: remove",
    "make the lamp post disappear": "lamp post: remove",
    "cut the bear out": "bear: remove",
    "remove it": "it: remove",
    "delete the trash can": "trashcan: remove",
    "remove the person in the red jacket": "person (red jacket): remove",
}
READINGS = {
    **PAINT,
    **ADJUST,
    **SEVERAL,
    **PARTS,
    **WHICH,
    **NEGATION,
    **LOOK,
    **REMOVE,
}


@pytest.mark.parametrize(("sentence", "reading"), READINGS.items())
def test_a_sentence_is_read(sentence, reading):
    assert " | ".join(map(str, read(sentence))) == reading


@pytest.mark.parametrize(
    ("sentence", "unread"),
    [
        ("don't paint the bike red", "don't"),
        ("make the bike less red", "less"),
        ("turn it into a Van Gogh painting", "gogh"),
        ("make it a polar bear", "polar"),
        ("a red dragon", "dragon"),
        ("paint the bike red with flames", "flames"),
        ("add a red hat", "add"),
        ("make it nice", "nice"),
        ("make the sky beautiful", "beautiful"),
        ("make the bear happy and the wall white", "happy"),
        ("make the car glossy", "glossy"),
        ("replace the bike with a car", "replace"),
        ("make the chair the same as the table", "same"),
        ("sharpen the background", "sharpen"),
        ("rends le vélo rouge", "rends"),
        ("把自行车涂成红色", "把自行车涂成红色"),
    ],
)
def test_what_is_not_understood_is_named(sentence, unread):
    """It is of the action "other": only an editor with a model of its own takes it."""
    others = [
        instruction for instruction in read(sentence) if instruction.action == "other"
    ]
    assert others and unread in others[0].unread


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


def test_every_content_word_is_used_or_named():
    """A word that is left out of a sentence leaves the reading, or was a filler."""
    for sentence in READINGS:
        said = " ".join(
            f"{instruction} {instruction.text}" for instruction in read(sentence)
        )
        for word in ("red", "background", "except", "not", "without"):
            if word in sentence.lower().split():
                assert word in said or "without" in said or "background" in said, (
                    sentence
                )


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
