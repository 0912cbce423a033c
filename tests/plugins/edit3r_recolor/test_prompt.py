import pytest
from edit3r_recolor.prompt import Instruction, parse_prompt
from edit3r_recolor.steps import Adjust, Paint, Sample, Tint
from hypothesis import given, settings
from hypothesis import strategies as st

from edit3r.errors import PromptError


def one(prompt: str) -> Instruction:
    (instruction,) = parse_prompt(prompt)
    return instruction


@pytest.mark.parametrize(
    "prompt, colour, subject",
    [
        ("paint the bike red", "red", ("bike",)),
        ("Paint the bike RED, please!", "red", ("bike",)),
        ("turn the wall light blue", "light blue", ("wall",)),
        ("make the red bike blue", "blue", ("red", "bike")),
        (
            "change the colour of the old chair to dark green",
            "dark green",
            ("old", "chair"),
        ),
        ("I would like the bear to be gold", "gold", ("bear",)),
        ("paint it #ff8800", "#ff8800", ()),
        ("turn the orange blue", "blue", ("orange",)),
        ("make the motorcycle look like it is made of gold", "gold", ("motorcycle",)),
        ("paint the bike red, keep everything else unchanged", "red", ("bike",)),
        ("red", "red", ()),
        ("paint the bear navy blue", "navy blue", ("bear",)),
        ("change the bear's colour to gold", "gold", ("bear",)),
        ("recolor the chair in teal", "teal", ("chair",)),
        ("paint the bear, please, blue", "blue", ("bear",)),
        ("spray paint both doors green", "green", ("doors",)),
        ("paint the wall red and leave the bear untouched", "red", ("wall",)),
    ],
)
def test_paints(prompt, colour, subject):
    instruction = one(prompt)
    assert [step.colour for step in instruction.steps if isinstance(step, Paint)] == [
        colour
    ] and len(instruction.steps) == 1
    assert (instruction.scope, instruction.subject) == ("object", subject)


@pytest.mark.parametrize(
    "prompt, what, sign, scope",
    [
        ("make it warmer", "warmth", 1, "everything"),
        ("darken the wall", "brightness", -1, "object"),
        ("make everything darker", "brightness", -1, "everything"),
        ("black and white", "greyscale", 1, "everything"),
        ("convert the photo to black-and-white", "greyscale", 1, "everything"),
        ("make the house greyscale", "greyscale", 1, "object"),
        ("increase the saturation of the wall", "saturation", 1, "object"),
        ("less contrast", "contrast", -1, "everything"),
        ("less saturated", "saturation", -1, "everything"),
        ("make the background colder", "warmth", -1, "background"),
        ("give the picture a sepia tone", "sepia", 1, "everything"),
    ],
)
def test_adjustments(prompt, what, sign, scope):
    instruction = one(prompt)
    assert instruction.scope == scope and len(instruction.steps) == 1
    step = instruction.steps[0]
    assert isinstance(step, Adjust) and step.what == what and step.amount * sign > 0


def test_degrees_scale_an_adjustment():
    weak, plain, strong = (
        one(p).steps[0].amount
        for p in ("slightly brighter", "brighter", "a lot brighter")
    )
    assert 0 < weak < plain < strong


def test_tints():
    for prompt in ("bluer", "make it more blue"):
        step = one(prompt).steps[0]
        assert isinstance(step, Tint) and step.colour == "blue"


def test_steps_of_several_clauses_are_taken_together_paint_first():
    for prompt in (
        "make the bike darker and paint the bike red",
        "paint the bike red and make it darker",
    ):
        instruction = one(prompt)
        assert [type(step) for step in instruction.steps] == [
            Paint,
            Adjust,
        ] and instruction.subject == ("bike",)
    assert len(one("make it brighter and warmer").steps) == 2


@pytest.mark.parametrize(
    "prompt, read",
    [
        ("paint the door green and the wall white", "door: green; wall: white"),
        ("the roof dark red, the door green", "roof: dark red; door: green"),
        ("turn the car blue and the background grey", "car: blue; background: grey"),
        ("make everything warmer and the car red", "all: warmth +1; car: red"),
        (
            "make the car bluer and recolor the sofa",
            "car: blue +0.35; sofa: colours drawn by the seed",
        ),
        ("paint the door and the wall white", "door: white; wall: white"),
        (
            "make the wall and door white and the roof red",
            "wall: white; door: white; roof: red",
        ),
        (
            "paint the old door, the wall and the roof white",
            "old door: white; wall: white; roof: white",
        ),
        ("darken the door and the wall", "wall: brightness -1; door: brightness -1"),
        (
            "turn the door and the wall from grey to blue",
            "door where it is near grey: blue; wall where it is near grey: blue",
        ),
    ],
)
def test_two_colours_go_on_two_things_in_the_order_of_the_sentence(prompt, read):
    assert "; ".join(map(str, parse_prompt(prompt))) == read


@pytest.mark.parametrize(
    "prompt, scope, subject, near, colour",
    [
        ("turn the wall from grey to brown", "object", ("wall",), "grey", "brown"),
        (
            "change the colour from light blue to gold",
            "everything",
            (),
            "light blue",
            "gold",
        ),
        ("from grey to brown", "everything", (), "grey", "brown"),
        ("turn red into blue", "everything", (), "red", "blue"),
        ("replace the red with green", "everything", (), "red", "green"),
        ("make the wall white instead of grey", "object", ("wall",), "grey", "white"),
    ],
)
def test_from_one_colour_to_another(prompt, scope, subject, near, colour):
    instruction = one(prompt)
    assert (instruction.scope, instruction.subject, instruction.near.colour) == (
        scope,
        subject,
        near,
    )
    assert [step.colour for step in instruction.steps] == [colour]


@pytest.mark.parametrize(
    "prompt",
    [
        "paint everything except the bear red",
        "paint everything red except the bear",
        "make everything but the bear red",
        "all the picture except for the bear red",
        "paint the rest of the picture apart from the bear red",
        "paint everything red but keep the bear as it is",
        "make the background red, and leave the bear in colour",
    ],
)
def test_everything_except_one_thing(prompt):
    instruction = one(prompt)
    assert (instruction.scope, instruction.subject) == ("all but", ("bear",))
    assert [step.colour for step in instruction.steps] == ["red"]


def test_it_says_which_words_it_used():
    first, second = parse_prompt(
        "Please paint the old door green, and the wall much darker"
    )
    assert (first.words, second.words) == (
        ("old", "door", "green"),
        ("wall", "much", "darker"),
    )
    assert (str(first), str(second)) == ("old door: green", "wall: brightness -1.7")


@pytest.mark.parametrize("prompt", ["recolor the bike", "recolour"])
def test_colours_are_drawn_only_where_that_is_asked_for(prompt):
    assert one(prompt).steps == (Sample(),)


@pytest.mark.parametrize("prompt", ["", "   "])
def test_no_prompt_is_an_error_that_says_what_to_do(prompt):
    with pytest.raises(PromptError, match=r"--prompt.*--editor none"):
        parse_prompt(prompt)


@pytest.mark.parametrize(
    "prompt",
    [
        "don't paint the bike red",
        "make the bike less red",
        "turn it into a Van Gogh painting",
        "make it a polar bear",
        "a red dragon",
        "paint the bike red with flames",
        "add a red hat",
        "add snow",
        "make it look like winter",
        "paint the bike red and blue",
        "paint the bike red except the wheel",
        "make everything except red",
        "make everything but the bear and the tree darker",
        "remove the bike",
        "paint the bike",
        "paint the door and the wall",
        "paint the door red and the wall",
        "make the bear happy and the wall white",
        "make the car metallic blue",
        "replace the bike with a car",
        "rends le vélo rouge",
        "把自行车涂成红色",
        "???",
        "keep everything unchanged",
    ],
)
def test_what_it_cannot_do_is_an_error_that_says_what_it_can(prompt):
    with pytest.raises(PromptError) as caught:
        parse_prompt(prompt)
    assert any(way in str(caught.value) for way in ("paint the bike red", "name one"))


def test_a_misspelt_colour_is_suggested():
    with pytest.raises(PromptError, match="Did you mean 'purple'"):
        parse_prompt("paint the bike purpel")


KNOWN = "paint make turn the bike wall red light blue darker warmer more less it everything and , not background very "
KNOWN += "from to except but all apart rest"


@settings(max_examples=150, deadline=None)
@given(
    st.one_of(
        st.text(max_size=30),
        st.lists(st.sampled_from(KNOWN.split()), max_size=9).map(" ".join),
    )
)
def test_any_text_is_read_or_refused(text):
    try:
        found = parse_prompt(text)
    except PromptError:
        return
    assert found and all(each.steps and each.words for each in found)
    assert "not" not in text.split() and "less red" not in text
