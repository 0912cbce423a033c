"""Where each instruction applies: what is marked, named, left out, or near a colour."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.interfaces import (
    SUBJECT,
    MaskLogits,
    Proposal,
    Segmenter,
    Selection,
    Tracks,
)
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Views
from edit3r.running import usual_selector
from edit3r.running.editors import read
from edit3r.running.selecting.regions import (
    MARKED,
    RegionFinder,
    _beneath,
    _median_colour,
    _without_rims,
)

HEIGHT, WIDTH = 12, 16
LEFT, RIGHT = slice(0, 7), slice(7, None)


class Halves(Segmenter):
    """Knows the left half as "door" and the right half as "wall"; follows into `found_in`."""

    def __init__(self, found_in=(0, 1)):
        self.found_in = found_in
        self.looked_up = []

    def _half(self, image, columns):
        mask = torch.zeros(image.shape[-2:])
        mask[:, columns] = 1
        return Proposal(mask)

    def masks(self, image, clicks, box=None, before=None):
        return MaskLogits(self.clicked(image).soft_mask[None] * 20 - 10)

    def clicked(self, image):
        return self._half(image, LEFT)

    def track(self, images, masks):
        logits = (20 * masks - 10).expand(len(images), -1, -1, -1).clone()
        present = torch.tensor([[view in self.found_in] for view in range(len(images))])
        hidden = logits.clamp(max=-1)
        return Tracks(torch.where(present[..., None, None], logits, hidden), present)

    def words(self, image, text):
        if text == SUBJECT:
            return (self._half(image, LEFT),)
        self.looked_up.append(text)
        known = {
            "door": (LEFT,),
            "wall": (RIGHT,),
            "half": (LEFT, RIGHT),
            "cups": (LEFT, RIGHT),
            "house": (slice(0, WIDTH),),
        }
        columns = known.get(text, ())
        return tuple(self._half(image, one) for one in columns)


def photos() -> Views:
    """Left third grey of several tones, middle third dull red, right third blue."""
    images = torch.empty(1, 2, 3, HEIGHT, WIDTH)
    images[..., :5] = torch.linspace(0.35, 0.65, HEIGHT)[:, None]
    images[..., 5:10] = torch.tensor([0.55, 0.16, 0.14])[:, None, None]
    images[..., 10:] = torch.tensor([0.1, 0.25, 0.8])[:, None, None]
    return Views(images, torch.eye(3).expand(1, 2, 3, 3), ("a", "b"))


def regions(prompt, marked=None, segmenter=None, known=None, **defaults):
    """Masks [instruction, view, height, width]."""
    segmenter = segmenter or Halves()
    return finder(marked, segmenter, known, **defaults).find(read(prompt)).masks


def finder(marked=None, segmenter=None, known=None, **defaults):
    chosen = usual_selector(segmenter or Halves())
    defaults = Selection(**defaults)
    return RegionFinder(photos(), lambda: chosen, lambda: None, marked, defaults, known)


def columns(mask) -> list[bool]:
    """Which columns of both views are in a mask."""
    return (mask > 0.5).all(0).all(0).tolist()


IN_LEFT = [True] * 7 + [False] * 9
IN_RIGHT = [False] * 7 + [True] * 9
EVERYWHERE = [True] * 16
CLICK = Selection(positive=((0, 0.2, 0.5),))


@pytest.mark.parametrize(
    ("prompt", "expected"),
    [
        ("paint the door red", IN_LEFT),
        ("make it darker", EVERYWHERE),
        ("make everything darker", EVERYWHERE),
        ("paint everything except the door red", IN_RIGHT),
        ("paint the right half red", [False] * 8 + [True] * 8),
        ("paint all half red", EVERYWHERE),
        ("make the background darker, but not the door", IN_RIGHT),
    ],
)
def test_things_are_looked_up_by_name(prompt, expected):
    assert columns(regions(prompt)[0]) == expected


@pytest.mark.parametrize(
    ("prompt", "expected"),
    [
        ("paint it red", IN_LEFT),
        ("paint the fox red", IN_LEFT),
        ("make it darker", IN_LEFT),
        ("the background in black and white", IN_RIGHT),
        ("everything black and white except the fox", IN_RIGHT),
        ("paint the fox red but not the door", [False] * 16),
        ("paint the house red", IN_LEFT),  # half of what has this name
        ("paint the house of the street red", IN_LEFT),  # a part's name does not
        ("paint the wall red", IN_LEFT),  # what has this name is elsewhere
    ],
)
def test_marks_stand_for_what_the_sentence_names(prompt, expected):
    assert columns(regions(prompt, CLICK)[0]) == expected


def test_a_name_says_how_far_goes_what_a_click_finds_a_small_part_of():
    class Small(Halves):
        def clicked(self, image):
            return self._half(image, slice(0, 3))

    assert columns(regions("paint the house red", CLICK, Small())[0]) == EVERYWHERE


def test_two_instructions_have_their_own_regions_and_a_thing_is_looked_for_once():
    segmenter = Halves()
    found = regions(
        "paint the door red, the wall green and the door darker", None, segmenter
    )
    assert [columns(mask) for mask in found][:2] == [IN_LEFT, IN_RIGHT]
    # once on each photo, since both reach along its sides
    assert segmenter.looked_up == ["door", "door", "wall", "wall"]


def test_the_rest_is_all_but_what_is_named_beside_it():
    found = regions("turn the door blue and the background grey")
    assert [columns(mask) for mask in found] == [IN_LEFT, IN_RIGHT]


def test_marks_cannot_stand_for_two_things():
    with pytest.raises(PromptError, match=r"'door' and 'wall'.*--from"):
        regions("paint the door green and the wall white", CLICK)


@pytest.mark.parametrize(
    ("sentence", "why"),
    [
        ("paint the fox red", "'fox' was not found"),
        ("paint it red", "which object is meant"),
    ],
)
def test_what_is_not_known_is_a_question(sentence, why):
    with collecting(Report()) as report:
        assert columns(regions(sentence)[0]) == IN_LEFT
    assert why in report.warnings[0] and "--point" in report.warnings[0]


def test_all_of_a_view_changes_where_what_is_left_out_is_not_found():
    class Lost(Halves):
        """Finds the door on the first photo that it is asked about, and nowhere else."""

        def words(self, image, text):
            return () if self.looked_up else super().words(image, text)

    lost = Lost(found_in=(0,))
    with collecting(Report()) as report:
        found = regions("paint everything except the door red", None, lost)[0]
    assert not found[0].all() and found[1].all()
    assert any("photo 2" in text for text in report.warnings)


@pytest.mark.parametrize("rest", ["the background", "everything except the door"])
def test_all_but_a_given_mask_is_everything_where_that_is_empty(rest):
    door = torch.zeros(HEIGHT, WIDTH)
    given = Selection(masks={0: (door + 1).tril(), 1: door})
    found = regions(f"paint {rest} red", given)[0]
    assert not found[0].all() and found[1].all()


@pytest.mark.parametrize(("near", "third"), [("grey", 0), ("red", 1), ("blue", 2)])
def test_only_pixels_near_a_colour_are_meant(near, third):
    found = regions(f"from {near} to brown")[0][0].mean(0)
    thirds = [
        float(found[part].mean()) for part in (slice(0, 5), slice(5, 10), slice(10, 16))
    ]
    assert [round(share) for share in thirds] == [int(i == third) for i in range(3)]


def test_the_red_parts_of_a_thing_are_inside_it():
    assert columns(regions("make the red parts of the door blue")[0]) == [
        5 <= column < 7 for column in range(WIDTH)
    ]


def test_colours_can_change_places():
    red, blue = regions("turn red into blue and blue into red")
    assert not (red * blue).any()


def test_a_colour_that_is_not_there_is_an_error():
    with pytest.raises(PromptError, match="nothing there is near green"):
        regions("from green to brown")


def test_what_was_named_in_an_earlier_run_is_known():
    fox = torch.zeros(2, HEIGHT, WIDTH)
    fox[..., RIGHT] = 1
    known = {"fox": fox}
    assert columns(regions("paint the fox red", known=known)[0]) == IN_RIGHT
    assert columns(regions("paint it red", known=known)[0]) == IN_RIGHT
    with collecting(Report()) as report:
        regions("paint the cat red", known=known)
    assert "'cat' was not found" in report.warnings[0]


def test_names_of_what_was_marked_and_found_are_kept_the_newest_last():
    known = {"door": torch.ones(2, HEIGHT, WIDTH), "wall": torch.ones(2, HEIGHT, WIDTH)}
    marked = Selection(positive=((0, 0.1, 0.5),))
    things = finder(marked, known=known).find(read("paint the door red")).things
    assert list(things) == ["wall", "door"]
    assert columns(things["door"]) == IN_LEFT
    kept = finder(marked, known=known, inverted=True).find(read("paint the door red"))
    assert columns(kept.things["door"]) == EVERYWHERE


def test_inverted_is_all_else_and_a_grown_outline_moves():
    assert columns(regions("paint the door red", inverted=True)[0]) == IN_RIGHT
    grown = columns(regions("paint the door red", grow=2.0)[0])
    assert grown == [True] * 9 + [False] * 7
    shrunk = columns(regions("paint the door red", grow=-1.0)[0])
    assert shrunk == [True] * 6 + [False] * 10


# ---- places, colours of other things, and what earlier runs named ----


def test_a_place_of_the_picture_is_its_box():
    assert columns(regions("brighten the left half")[0]) == [True] * 8 + [False] * 8
    third = regions("darken the lower third of the picture")[0][0]
    assert third.mean(1).tolist() == [0.0] * 8 + [1.0] * 4


def test_a_place_and_a_click_together_are_an_error():
    with pytest.raises(PromptError, match=r"left half of the picture.*keep only one"):
        regions("brighten the left half", CLICK)


def test_a_colour_is_read_off_another_thing():
    (instruction,) = (
        finder().find(read("paint the door the colour of the wall")).instructions
    )
    assert instruction.changes[0].colour.rgb == pytest.approx((0.1, 0.25, 0.8))
    assert str(instruction) == "door: the colour of wall (#1a40cc)"


def test_the_red_of_a_thing_is_that_of_its_red_parts():
    (instruction,) = (
        finder().find(read("paint the door the red of the wall")).instructions
    )
    assert instruction.changes[0].colour.rgb == pytest.approx((0.55, 0.16, 0.14))


def test_a_click_can_be_where_a_colour_comes_from():
    click = Selection(positive=((0, 0.9, 0.5),))
    prompt = "paint the wall the colour of what I clicked on"
    found = finder(click).find(read(prompt))
    assert columns(found.masks[0]) == IN_RIGHT
    assert found.instructions[0].changes[0].colour is not None


def test_a_colour_of_what_is_not_found_is_an_error_that_asks_for_its_name():
    with pytest.raises(InputError, match=r"colour of stone cannot be read.*#8a7f70"):
        regions("paint the door the colour of the stone")


def test_it_is_what_an_earlier_run_named_also_where_it_only_gets_darker():
    fox = torch.zeros(2, HEIGHT, WIDTH)
    fox[..., RIGHT] = 1
    known = {"fox": fox}
    assert columns(regions("make it darker", known=known)[0]) == IN_RIGHT
    assert columns(regions("everything darker", known=known)[0]) == EVERYWHERE


def test_the_background_is_all_but_what_earlier_runs_named():
    fox = torch.zeros(2, HEIGHT, WIDTH)
    fox[..., RIGHT] = 1
    found = regions("make the background darker", known={"fox": fox})[0]
    assert columns(found) == IN_LEFT


def test_all_of_a_thing_is_kept_under_the_name_of_the_thing():
    things = finder().find(read("turn all of the door to gold")).things
    assert list(things) == ["door"]


@pytest.mark.parametrize(
    ("name", "kept_as"), [("door", "door"), ("zorb", "zorb"), ("wall", MARKED)]
)
def test_what_is_marked_is_kept_by_a_name_that_was_not_found_elsewhere(name, kept_as):
    assert list(finder(CLICK).find(read(f"paint the {name} red")).things) == [kept_as]


def test_all_of_a_name_but_one_of_them():
    assert columns(regions("remove the cups but the left one")[0]) == IN_RIGHT


@pytest.mark.parametrize(
    ("prompt", "expected"),
    [
        ("paint the cups red", EVERYWHERE),
        ("paint all cups red", EVERYWHERE),
        ("paint the left cups red", IN_LEFT),
    ],
)
def test_a_plural_means_all_of_its_name(prompt, expected):
    assert columns(regions(prompt)[0]) == expected


@pytest.mark.parametrize(
    ("prompt", "told"),
    [
        ("make the zorbic wall green", ["'zorbic' in 'zorbic wall' is not known here"]),
        ("make the old wall green", []),
        ("make the zorbic green", []),  # the one name that it may have
    ],
)
def test_an_unknown_word_of_what_is_clicked_on_is_named(prompt, told):
    with collecting(Report()) as report:
        finder(Selection(positive=((0, 0.2, 0.5),))).find(read(prompt))
    assert [one[: len(text)] for one, text in zip(report.warnings, told)] == told
    assert len(report.warnings) == len(told)


def test_what_a_thing_stands_on_lends_it_its_colour():
    """ "The colour of the stone it stands on" is read under the thing, whatever stone is."""
    thing = torch.zeros(2, 1, HEIGHT, WIDTH)
    thing[:, :, 2:11, 5:10] = 1
    marked = Selection(masks={0: thing[0, 0], 1: thing[1, 0]})
    views = photos()
    views.images[..., 11:, :] = torch.tensor([0.2, 0.6, 0.3])[:, None, None]
    segmenter = Halves()
    found = RegionFinder(
        views, lambda: usual_selector(segmenter), lambda: None, marked
    ).find(read("give the bear the colour of the stone it stands on"))
    (change,) = found.instructions[0].changes
    assert change.colour.rgb == pytest.approx((0.2, 0.6, 0.3))
    assert "stone" not in segmenter.looked_up


def test_a_kept_cup_has_no_rim_that_goes_with_the_others():
    masks = torch.zeros(1, 100, 100)
    masks[:, 20:60, 20:40] = 1  # a cup that goes
    masks[:, 20:60, 60:81] = 1  # one that stays, as "all cups" outlines it
    masks[:, 21:60, 61:80] = 0  # and as its own outline is
    left = _without_rims(masks)
    assert left[:, :, 50:].sum() == 0 and torch.equal(left[..., :50], masks[..., :50])


class Unsure(Halves):
    """Takes the left half for a pot as well, and is as sure of that as told."""

    def __init__(self, confidence):
        super().__init__()
        self.confidence = confidence

    def words(self, image, text):
        if text != "pot":
            return super().words(image, text)
        return (replace(self._half(image, LEFT), confidence=self.confidence),)


@pytest.mark.parametrize(
    ("confidence", "changed"), [(0.35, IN_LEFT), (0.9, [False] * 16)]
)
def test_what_is_kept_is_not_the_thing_to_change_where_its_name_is_unsure(
    confidence, changed
):
    report = Report()
    with collecting(report):
        masks = regions("paint the door red, not the pot", segmenter=Unsure(confidence))
    assert columns(masks[0]) == changed
    told = any("'pot' is 'door' itself" in text for text in report.warnings)
    assert told == any(changed)


def test_all_else_of_all_else_is_the_thing():
    clicked = Selection(positive=((0, 0.2, 0.5),))
    all_else = replace(clicked, inverted=True)
    thing = regions("paint it red", marked=clicked)
    assert torch.equal(regions("paint it red", all_else, inverted=True), thing)
    other = regions("paint it red", marked=all_else)
    assert columns(other[0]) != columns(thing[0])


def test_beneath_a_thing_is_a_strip_under_where_it_stands_not_under_its_snout():
    """Of a picture 100 rows high: the thing ends at row 59, its snout at row 39."""
    masks = torch.zeros(2, 100, 40)
    masks[1, 20:60, 5:15] = masks[1, 30:40, 15:20] = 1
    expected = torch.zeros(100, 40)
    expected[61:65, 5:15] = 1
    assert torch.equal(_beneath(masks)[1], expected)


def test_a_colour_is_the_median_of_all_photos_that_show_the_thing():
    images = torch.rand(2, 3, 4, 5)
    mask = torch.zeros(2, 4, 5)
    mask[0, 1, 2:4] = mask[1, 3, 0] = 1
    seen = torch.stack((images[0, :, 1, 2], images[0, :, 1, 3], images[1, :, 3, 0]))
    assert _median_colour(images, mask) == tuple(seen.median(0).values.tolist())
    with pytest.raises(InputError, match="shows on no photo"):
        _median_colour(images, 0 * mask)
