"""A model's answer is held to the rules of the grammar: what is wrong is named or sent back."""

import json

import pytest
from edit3r_language.answers import MAX_ANSWER, instructions_of_answer
from edit3r_language.grammar import GrammarReader

from edit3r.contract.errors import PromptError


def instruction(text, action="paint", colour="", kind="paint", **more):
    change = {"kind": kind, "colour": colour, **more.pop("change", {})}
    changes = [change] if action == "paint" else []
    thing = {"scope": "named", "name": "wall", **more.pop("thing", {})}
    return {"action": action, "thing": thing, "changes": changes, "text": text, **more}


def read(prompt, *instructions):
    return instructions_of_answer(json.dumps({"instructions": instructions}), prompt)


SAME = {
    "paint the wall sage green": [
        instruction("paint the wall sage green", colour="sage green")
    ],
    "make the left wall darker": [
        instruction(
            "make the left wall darker",
            kind="brightness",
            change={"amount": -1},
            thing={"which": ["left"]},
        )
    ],
    "paint the wall gold and remove the bin": [
        instruction("paint the wall gold", change={"material": "gold"}),
        instruction("and remove the bin", "remove", thing={"name": "bin"}),
    ],
    "paint the left half white": [
        instruction(
            "paint the left half white",
            colour="white",
            thing={"scope": "region", "name": "left half"},
        )
    ],
    "paint the wall the colour of the door": [
        instruction(
            "paint the wall the colour of the door",
            change={"like": {"scope": "named", "name": "door"}},
        )
    ],
    "everything except the wall as a sketch": [
        instruction(
            "everything except the wall as a sketch",
            "look",
            look="sketch",
            thing={"scope": "whole", "name": ""},
            without=[{"scope": "named", "name": "wall"}],
        )
    ],
}


@pytest.mark.parametrize("sentence", SAME)
def test_a_right_answer_gives_the_instructions_of_the_grammar(sentence):
    said, grammar = read(sentence, *SAME[sentence]), GrammarReader().read(sentence)
    assert list(map(str, said)) == list(map(str, grammar))
    assert [one.changes for one in said] == [one.changes for one in grammar]
    assert [one.target.box for one in said] == [one.target.box for one in grammar]


UNREAD = {
    "a colour that nobody knows": (
        "paint the wall zorbic",
        instruction("paint the wall zorbic", colour="zorbic"),
        ("zorbic",),
    ),
    "a material that nobody knows": (
        "turn the wall into jelly",
        instruction(
            "turn the wall into jelly", colour="red", change={"material": "jelly"}
        ),
        ("jelly",),
    ),
    "a place that nobody knows": (
        "paint the outskirts red",
        instruction(
            "paint the outskirts red",
            colour="red",
            thing={"scope": "region", "name": "outskirts"},
        ),
        ("outskirts",),
    ),
    "what the model says itself": (
        "paint the wall red qwxz",
        instruction("paint the wall red", colour="red", unread=["qwxz"]),
        ("qwxz",),
    ),
    "words that it speaks of nowhere": (
        "paint the wall red and remove the bin",
        instruction("paint the wall red", colour="red"),
        ("remove", "bin"),
    ),
}


@pytest.mark.parametrize("case", UNREAD)
def test_nothing_that_was_said_disappears(case):
    sentence, said, unread = UNREAD[case]
    others = [one for one in read(sentence, said) if one.action == "other"]
    assert [one.unread for one in others] == [unread]


def test_a_word_that_picks_nothing_goes_with_the_name():
    said = instruction(
        "paint the striped wall red", colour="red", thing={"which": ["striped"]}
    )
    (one,) = read("paint the striped wall red", said)
    assert (one.target.name, one.target.qualifiers) == ("striped wall", ())


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ("Sure, I painted it.", "no JSON object"),
        ('{"instructions": [{"action": "paint"}]}', "text"),
        (
            '{"instructions": [{"action": "dance", "text": "a"}]}',
            "instructions.0.action",
        ),
        ('{"instructions": [{"action": "paint", "text": "a"}]}', "names no change"),
        ('{"instructions": [{"action": "look", "text": "a"}]}', "gives a look"),
        ('{"instructions": [], "command": "rm"}', "command"),
        ('{"instructions": [{"action": "remove", "text": "a\\u001b[2J"}]}', "pattern"),
        (json.dumps({"instructions": [instruction("a", "remove")] * 21}), "at most 20"),
        ("x" * MAX_ANSWER + "{}", "no JSON object"),
    ],
)
def test_an_answer_of_another_form_is_refused_with_what_is_wrong(answer, why):
    with pytest.raises(ValueError, match=why):
        instructions_of_answer(answer, "a")


def test_words_around_the_json_do_not_matter():
    said = json.dumps(
        {"instructions": [instruction("paint the wall red", colour="red")]}
    )
    answer = f"Here it is:\n```json\n{said}\n```"
    (one,) = instructions_of_answer(answer, "paint the wall red")
    assert str(one) == "wall: red"


def test_nothing_asked_for_and_two_colours_are_the_users_to_mend():
    with pytest.raises(PromptError, match="asks for no change"):
        read("hello")
    both = [instruction("paint the wall red", colour=one) for one in ("red", "blue")]
    with pytest.raises(PromptError, match="two colours at once"):
        read("paint the wall red", *both)
