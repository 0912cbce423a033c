"""The selector's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Selected, Selector
from edit3r_testing import SelectorContract


class Spoiled(Selector):
    """A good selector asked for something else than it should be, or with its answer changed."""

    def __init__(self, good, ask=None, answer=None):
        self.good, self.ask, self.answer = good, ask, answer

    def select(self, views, selection, geometry=None):
        asked = self.ask(selection) if self.ask else selection
        try:
            found = self.good.select(views, asked, geometry)
        except InputError as error:
            found = error
        changed = self.answer(found, views, selection) if self.answer else found
        if isinstance(changed, Exception):
            raise changed
        return changed


def masks(change):
    """The answer with its masks changed; refusals stay."""

    def answer(found, *_):
        if isinstance(found, Exception):
            return found
        return replace(found, masks=change(found.masks.clone()))

    return answer


def ways(change):
    return lambda found, *_: (
        found if isinstance(found, Exception) else replace(found, how=change(found.how))
    )


def instead_of_refusing(mask):
    """All photos alike where the good one refuses."""

    def answer(found, views, selection):
        if not isinstance(found, Exception):
            return found
        images = views.images[0]
        return Selected(torch.full_like(images[:, :1], mask), ("marked",) * len(images))

    return answer


def write_into(found, views, _):
    views.images.add_(0.01)
    return found


def lost(found):
    found[1] = 0
    return found


def aside(found):
    found[1] = found[1].roll(40, -1)
    return found


CLICK = "test_a_click_is_obeyed_with_geometry_and_without"
HOW = "test_it_says_how_it_found_the_thing_on_each_photo"
CARRY = "test_geometry_carries_the_thing_to_other_photos"
MARKS = "test_every_other_mark_is_obeyed_or_refused"
GROW = "test_outlines_grow_and_shrink"
INVERT = "test_inverted_is_all_but_the_thing"
PHOTO, WORDS = (
    "test_marks_on_no_photo_are_refused",
    "test_words_that_nobody_knows_are_a_question",
)
TWICE = "test_same_marks_give_the_same_masks"
ALONE = "test_leaves_its_inputs_alone"
CASES = {
    "a tuple": (
        {"answer": lambda found, *_: (found,)},
        CLICK,
        "interfaces.Selected, got tuple",
    ),
    "masks without a channel": (
        {"answer": masks(lambda m: m[:, 0])},
        CLICK,
        "of shape [3, 1, 72, 96]",
    ),
    "logits": (
        {"answer": masks(lambda m: 8 * m - 4)},
        CLICK,
        "return masks in [0, 1], got -4 to 4",
    ),
    "nothing": ({"answer": masks(torch.zeros_like)}, CLICK, "is not selected"),
    "the second click unheard": (
        {"answer": masks(torch.ones_like)},
        CLICK,
        "selected though it was said not to be",
    ),
    "a click refused": (
        {"answer": lambda *_: InputError("no clicks")},
        CLICK,
        "a click was refused",
    ),
    "no reason": (
        {"answer": lambda *_: InputError("")},
        CLICK,
        "refused without a word",
    ),
    "a traceback": (
        {"answer": lambda *_: KeyError("view")},
        CLICK,
        "raised KeyError",
    ),
    "one word for all": (
        {"answer": ways(lambda h: h[:1])},
        HOW,
        "how it was found on each view",
    ),
    "a word of its own": (
        {"answer": ways(lambda h: ("lasso", *h[1:]))},
        HOW,
        "how it was found on each view",
    ),
    "an empty mask as marked": ({"answer": masks(lost)}, HOW, '"not found" where'),
    "photo 1 alone": ({"answer": masks(lost)}, CARRY, "overlaps by 0%"),
    "another place": (
        {"answer": masks(aside)},
        CARRY,
        "carry it by the geometry",
    ),
    "all for a box": (
        {"answer": instead_of_refusing(1.0)},
        MARKS,
        "a box selected all of photo 1",
    ),
    "nothing for a box": (
        {"answer": instead_of_refusing(0.0)},
        MARKS,
        "is not selected; masks obey marks",
    ),
    "the eraser ignored": (
        {"ask": lambda s: replace(s, removed={})},
        MARKS,
        "selected though it was said not to be",
    ),
    "always as large": ({"ask": lambda s: replace(s, grow=0)}, GROW, "selection.grow"),
    "the thing itself": (
        {"ask": lambda s: replace(s, inverted=False)},
        INVERT,
        "selected though it was said not to be",
    ),
    "nothing inverted": (
        {
            "answer": lambda found, _, s: (
                masks(torch.zeros_like)(found) if s.inverted else found
            )
        },
        INVERT,
        "inverted selects nothing",
    ),
    "photo 8": ({"answer": instead_of_refusing(1.0)}, PHOTO, "photo 8 of 3 was taken"),
    "any word": ({"answer": instead_of_refusing(1.0)}, WORDS, "raise InputError"),
    "chance": (
        {"answer": masks(lambda m: m * (0.9 + 0.1 * torch.rand(())))},
        TWICE,
        "seed what is random",
    ),
    "writing": ({"answer": write_into}, ALONE, "clone it first"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_selector_broken_by(case, examples, complaint):
    changes, claim, advice = CASES[case]
    good = examples.build("selector", "worked-selector")
    assert advice in complaint(
        SelectorContract, lambda: Spoiled(good, **changes), claim
    )


def test_every_claim_about_selectors_can_fail():
    own = {name for name in vars(SelectorContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
