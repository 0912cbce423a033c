"""What a user marks becomes masks on every view."""

from dataclasses import replace

import pytest
import torch
from edit3r_select.answering import Answered
from edit3r_select.by_segmenter import select_masks

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    SUBJECT,
    Geometry,
    MaskLogits,
    Proposal,
    Segmenter,
    Selection,
    Tracks,
)
from edit3r_testing.scenes import photograph

IMAGES = torch.rand(3, 3, 24, 32)
pytestmark = pytest.mark.usefixtures("sharp")


def square(row, column, size=6):
    mask = torch.zeros(24, 32)
    mask[row : row + size, column : column + size] = 1
    return mask


class Squares(Segmenter):
    """A square where one points, or what was there before, less the squares of clicks beside it;
    knows the word 'box'.
    """

    def __init__(self, lost=False):
        self.lost = lost

    def masks(self, image, clicks, box=None, before=None):
        wanted = [place for place, is_wanted in clicks if is_wanted]
        if before is not None:
            mask = (before > 0).float()
        elif wanted or box:
            x, y = wanted[0] if wanted else box[:2]
            mask = self.at(int(y * 24), int(x * 32), box)
        else:
            mask = torch.zeros(24, 32)
        for (x, y), is_wanted in clicks:
            if not is_wanted:
                mask = mask * (1 - square(int(y * 24), int(x * 32)))
        return answer(mask)

    def at(self, row, column, box):
        return square(row, column)

    def words(self, image, text):
        if text == SUBJECT:
            return (Proposal(square(1, 1)),)
        return self.named(image) if text == "box" else None

    def named(self, image):
        return (Proposal(square(2, 2)),)

    def track(self, images, masks):
        logits = torch.stack(
            [masks.roll(3 * view, -1) * 8 - 4 for view in range(len(images))]
        )
        present = torch.tensor(
            [[view == 0 or not self.lost] for view in range(len(images))]
        )
        return Tracks(logits, present)


def answer(*masks):
    return MaskLogits(torch.stack(masks) * 8 - 4)


def inside(selected, view):
    return selected.masks[view, 0] > 0.5


def test_a_click_on_one_view_marks_all_views():
    selected = select_masks(IMAGES, Selection(positive=((0, 0.25, 0.5),)), Squares())
    assert selected.masks.shape == (3, 1, 24, 32)
    assert selected.how == ("marked", "pictures", "pictures")
    assert (inside(selected, 0) == square(12, 8).bool()).all()
    assert (inside(selected, 1) == square(12, 11).bool()).all()


def test_a_mask_of_any_one_photo_is_carried_to_the_rest():
    selected = select_masks(IMAGES, Selection(masks={1: square(4, 4)}), Squares())
    assert selected.how == ("pictures", "given", "pictures")
    assert (selected.masks[1, 0] == square(4, 4)).all()
    assert (inside(selected, 0) == square(4, 7).bool()).all()


def test_of_two_given_masks_the_nearer_one_is_carried():
    images = torch.rand(5, 3, 24, 32)
    given = {0: square(1, 4), 4: square(16, 12)}
    selected = select_masks(images, Selection(masks=given), Squares())
    assert selected.how == ("given", *["pictures"] * 3, "given")
    assert (inside(selected, 1) == square(1, 7).bool()).all()
    assert (inside(selected, 3) == square(16, 15).bool()).all()


def test_a_correction_on_another_photo_keeps_what_was_carried_there():
    marks = Selection(positive=((0, 0.25, 0.5),), negative=((1, 0.5, 0.5),))
    selected = select_masks(IMAGES, marks, Squares())
    assert selected.how == ("marked", "marked", "pictures")
    expected = square(12, 11) * (1 - square(12, 16))
    assert (inside(selected, 1) == expected.bool()).all()


def test_brush_and_eraser_have_the_last_word():
    stroke, wiped = square(0, 20, 3), square(12, 8, 2)
    selected = select_masks(
        IMAGES,
        Selection(positive=((0, 0.25, 0.5),), added={0: stroke}, removed={0: wiped}),
        Squares(),
    )
    assert (selected.masks[0, 0][stroke > 0] == 1).all()
    assert (selected.masks[0, 0][wiped > 0] == 0).all()


def test_a_region_is_its_box_exactly_and_adds_to_clicks():
    box = (0.0, 0.0, 0.5, 0.25)
    alone = select_masks(IMAGES, Selection(regions=((0, box),)), Squares())
    height, width = IMAGES.shape[-2:]
    expected = torch.zeros(height, width)
    expected[: height // 4, : width // 2] = 1
    assert alone.how[0] == "region" and torch.equal(alone.masks[0, 0], expected)
    both = Selection(positive=((0, 0.25, 0.5),), regions=((0, box),))
    added = select_masks(IMAGES, both, Squares())
    assert added.how[0] == "marked" and (added.masks[0, 0] >= expected).all()
    with pytest.raises(InputError, match="box on photo 1"):
        Selection(regions=((0, (0.5, 0.5, 0.9, 0.1)),))


def test_unknown_words_take_what_stands_out_as_a_question():
    assert select_masks(IMAGES, Selection(words="box"), Squares()).how[0] == "words"
    for words, why in (("the teapot", "is not a word"), ("", "nothing says which")):
        found = select_masks(IMAGES, Selection(words=words), Squares())
        assert found.how[0] == "guess" and 0 < found.confidence <= 0.25
        assert not found.is_sure and (inside(found, 0) == square(1, 1).bool()).all()
        assert why in found.warnings[0] and "--point" in found.warnings[0]


def test_what_else_stands_out_is_a_candidate():
    class Two(Squares):
        def words(self, image, text):
            rows = (1, 1, 12) if text == SUBJECT else ()
            return tuple(Proposal(square(row, 1)) for row in rows) or None

    found = select_masks(IMAGES, Selection(words="teapot"), Two())
    assert [float(one.mask[3, 3]) for one in found.candidates] == [1, 0]  # what differs
    assert found.candidates[1].score < found.candidates[0].score == found.confidence
    second = select_masks(IMAGES, Selection(words="teapot", candidate=2), Two())
    assert (inside(second, 0) == square(12, 1).bool()).all()


def test_a_lost_object_is_told():
    selected = select_masks(
        IMAGES, Selection(positive=((0, 0.25, 0.5),)), Squares(lost=True)
    )
    assert selected.how[1] == "not found" and not inside(selected, 1).any()
    assert any("photo 2" in text for text in selected.warnings)


@pytest.mark.parametrize("measured", [1.0, 0.2])
def test_photos_of_one_surface_agree_what_belongs_to_the_thing(measured):
    ones = torch.ones(1, 2, 24, 32)
    c2w, placed = torch.eye(4).expand(1, 2, 4, 4), torch.ones(1, 2, dtype=torch.bool)
    geometry = Geometry(c2w, 2 * ones, measured * ones, placed)
    lenses = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    own = [square(9, 8) > 0.5, square(9, 19) > 0.5]
    images = torch.stack([one.expand(3, -1, -1).float() for one in own])
    boxes = {0: (8 / 32, 9 / 24, 0.2, 0.25), 1: (19 / 32, 9 / 24, 0.2, 0.25)}
    found = select_masks(images, Selection(boxes=boxes), Squares(), geometry, lenses)
    for view in range(2):
        wanted = own[0] | own[1] if measured > 0.5 else own[view]
        assert torch.equal(inside(found, view), wanted)


@pytest.mark.parametrize(
    ("measured", "elsewhere", "how"),
    [(0.2, 16, "words"), (0.8, 16, "geometry"), (0.2, 3, "geometry")],
)
def test_a_name_outweighs_a_place_that_depths_only_guess(measured, elsewhere, how):
    """A man walks between two photos; where words find what geometry carried, that stays."""

    class Walker(Squares):
        def words(self, image, text):
            column = 2 if image.mean() < 0.5 else elsewhere
            return (Proposal(square(2, column), 0.9),)

    ones = torch.ones(1, 2, 24, 32)
    c2w, placed = torch.eye(4).expand(1, 2, 4, 4), torch.ones(1, 2, dtype=torch.bool)
    geometry = Geometry(c2w, 2 * ones, measured * ones, placed)
    lenses = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    images = torch.stack((torch.zeros(3, 24, 32), torch.ones(3, 24, 32)))
    found = select_masks(images, Selection(words="man"), Walker(), geometry, lenses)
    assert found.how == ("words", how)
    column = elsewhere if how == "words" else 2
    assert torch.equal(inside(found, 1), square(2, column).bool())


def test_geometry_carries_before_pictures_do():
    scene = photograph(2, (48, 64))
    views = scene.views
    geometry = Geometry(
        scene.cameras.c2w,
        scene.depths,
        torch.ones_like(scene.depths),
        torch.ones(1, 2, dtype=torch.bool),
    )
    truth = scene.objects[:, 0]
    segmenter = Squares()
    given = Selection(masks={0: truth[0, 0]})
    selected = select_masks(
        views.images[0], given, segmenter, geometry, views.intrinsics
    )
    assert selected.how == ("given", "geometry")
    both = (inside(selected, 1) & (truth[0, 1] > 0.5)).sum() / (
        inside(selected, 1) | (truth[0, 1] > 0.5)
    ).sum()
    assert both > 0.7


@pytest.fixture
def told_by_half_a_photo(monkeypatch):
    """The marks for photos 1 and on, where photo 0 has depth on its left half and each answer is
    the whole photo; what they show.
    """

    def told(count):
        marks = []

        def whole(segmenter, image, asked):
            marks.append(asked)
            return Answered((Proposal(torch.ones_like(image[0])),), None)

        monkeypatch.setattr("edit3r_select.carrying.answered", whole)
        scene = photograph(3, (48, 64))
        depths = scene.depths[:, :count].clone()
        depths[:, 0, :, 32:] = 0
        geometry = Geometry(
            scene.cameras.c2w[:, :count],
            depths,
            torch.ones_like(depths),
            torch.ones(1, count, dtype=torch.bool),
        )
        truth = scene.objects[0, 0]
        views = scene.views.select(range(count))
        select_masks(
            views.images[0],
            Selection(masks={0: truth[0]}),
            Squares(),
            geometry,
            views.intrinsics,
        )
        return marks, truth > 0.5

    return told


def test_a_photo_without_marks_is_told_what_the_marked_one_shows_of_it(
    told_by_half_a_photo,
):
    (marks,), truth = told_by_half_a_photo(2)
    assert 0.2 < marks.known.float().mean() < 0.7
    wrong = (marks.prior > 0.5) != truth[1]
    assert wrong[marks.known].float().mean() < 0.1
    assert not marks.prior[~marks.known].any()


def test_of_the_rest_it_is_told_by_photos_to_which_it_was_carried(told_by_half_a_photo):
    (second, third), truth = told_by_half_a_photo(3)
    by_both, by_second = third.known, third.known & (third.prior == 1)
    assert by_both.float().mean() > second.known.float().mean() + 0.1
    # The second photo says "object" everywhere: where the marked one says otherwise, it holds.
    denied = by_both & (third.prior < 0.5)
    assert denied.sum() > 0.2 * by_both.sum() and by_second.any()
    assert (denied & truth[2]).sum() < 0.1 * denied.sum()


@pytest.mark.parametrize(
    "marks",
    [
        {"positive": ((0, 1.2, 0.5),)},
        {"positive": ((7, 0.2, 0.5),)},
        {"boxes": {0: (0.5, 0.5, 0.8, 0.2)}},
        {"boxes": {0: (0.5, 0.5, 0.2, float("nan"))}},
        {"boxes": {0: (float("nan"), 0.5, 0.2, 0.2)}},
        {"positive": ((0, 0.5, float("nan")),)},
        {"masks": {0: torch.full((24, 32), float("nan"))}},
        {"negative": ((0, 0.2, 0.5),), "positive": ((1, 0.2, 0.5),), "lost": True},
    ],
)
def test_marks_that_say_nothing_are_an_error(marks):
    lost = marks.pop("lost", False)
    with pytest.raises(InputError):
        select_masks(IMAGES, Selection(**marks), Squares(lost))


def test_a_click_where_it_was_lost_starts_anew_and_ends_the_warning():
    marks = Selection(positive=((0, 0.25, 0.5), (1, 0.5, 0.25)))
    selected = select_masks(IMAGES[:2], marks, Squares(lost=True))
    assert (inside(selected, 1) == square(6, 16).bool()).all() and not selected.warnings


def test_all_but_an_empty_mask_is_everything():
    given = {0: square(4, 4), 1: torch.zeros(24, 32)}
    selected = select_masks(
        IMAGES[:2], Selection(masks=given, inverted=True), Squares()
    )
    assert not selected.masks[0].all() and selected.masks[1].all()


class Surroundings(Squares):
    """A square stands out; finds again only what is small."""

    def words(self, image, text):
        return (Proposal(square(2, 2)),) if text == SUBJECT else None

    def track(self, images, masks):
        self.lost = bool(masks.mean() > 0.5)
        return super().track(images, masks)


def test_of_a_background_the_thing_before_it_is_found_again():
    asked = Selection(words="background", grow=1)
    selected = select_masks(IMAGES[:2], asked, Surroundings())
    assert torch.equal(selected.masks[1, 0] > 0.5, ~square(3, 6, 4).bool())


class Unsure(Squares):
    """Finds a box, but does not believe in it; around a box there is more."""

    def named(self, image):
        return (Proposal(square(2, 2), 0.3),)

    def masks(self, image, clicks, box=None, before=None):
        assert box is not None
        return answer(square(1, 1, 12), square(1, 1, 17), square(1, 1, 22))


def test_what_words_found_unsurely_is_taken_and_told_with_other_candidates():
    found = select_masks(IMAGES, Selection(words="box"), Unsure())
    assert found.how[0] == "words" and found.confidence == 0.3 and not found.is_sure
    assert (inside(found, 0) == square(2, 2).bool()).all()
    assert (
        "confidence of only 30%" in found.warnings[0]
        and "--candidate 2" in found.warnings[0]
    )
    second = select_masks(IMAGES, Selection(words="box", candidate=2), Unsure())
    assert inside(second, 0).sum() >= 12 * 12
    assert [one.number for one in second.candidates] == [1, 2, 3]


class Walkers(Squares):
    """People who stand elsewhere on each photo, told apart by its brightness; surest first."""

    def __init__(self, *confidences):
        super().__init__()
        self.confidences = confidences

    def words(self, image, text):
        first = 2 if image.mean() < 0.5 else 14
        found = [square(2, first), square(8, first + 4), square(16, first + 8)]
        return tuple(
            Proposal(mask, confidence)
            for mask, confidence in zip(found, self.confidences)
        )


@pytest.mark.parametrize(
    ("confidences", "several", "which", "each", "count"),
    [
        ((0.8, 0.6, 0.4), True, (), True, 2),  # one that is likely beside a sure one
        ((0.6, 0.55), True, (), True, 1),  # none is sure: the best of each photo
        ((0.6, 0.55), True, ("all",), True, 2),
        ((0.8, 0.6, 0.4), False, (), False, 1),  # one is followed
    ],
)
def test_several_are_looked_for_on_every_photo(
    confidences, several, which, each, count
):
    images = torch.stack((torch.zeros(3, 24, 32), torch.ones(3, 24, 32)))
    words = Selection(words="people", several=several, qualifiers=which)
    found = select_masks(images, words, Walkers(*confidences))
    assert (found.how == ("words", "words")) == each
    one = float(square(2, 2).sum())
    assert float(inside(found, 0).sum()) == count * one
    if each:
        there = inside(found, 1)
        assert there[2, 14] and not there[2, 2] and float(there.sum()) == count * one
    if several:
        assert found.confidence == (confidences[-1] if which else confidences[0])


@pytest.mark.parametrize(
    ("confidences", "which", "confidence"),
    [
        ((0.8, 0.6, 0.4), (), 0.4),  # two may be meant, and one is taken
        ((0.8, 0.4), (), 0.8),
        ((0.8, 0.7), ("left",), 0.8),
    ],
)
def test_of_several_of_one_name_none_is_surely_meant_unless_words_say_which(
    confidences, which, confidence
):
    found = select_masks(
        IMAGES, Selection(words="person", qualifiers=which), Walkers(*confidences)
    )
    assert found.confidence == confidence
    told = "2 things on photo 1 may be 'person'"
    assert any(told in text for text in found.warnings) == (confidence == 0.4)


def test_one_of_several_is_found_again_only_as_surely_as_it_was_found():
    """That nothing says which is meant makes others on other photos no likelier."""

    class Lost(Walkers):
        def track(self, images, masks):
            tracks = super().track(images, masks)
            return replace(tracks, present=torch.tensor([[True], [False]]))

        def words(self, image, text):
            found = super().words(image, text)
            return found if image.mean() < 0.5 else found[2:]

    images = torch.stack((torch.zeros(3, 24, 32), torch.ones(3, 24, 32)))
    found = select_masks(images, Selection(words="person"), Lost(0.8, 0.7, 0.5))
    assert found.confidence < 0.5 and found.how == ("words", "not found")


@pytest.mark.parametrize(("words", "how"), [("box", "words"), ("", "not found")])
def test_what_was_named_is_named_again_where_it_was_lost(words, how):
    chosen = Selection(words=words, masks={} if words else {0: square(2, 2)})
    found = select_masks(IMAGES, chosen, Squares(lost=True))
    assert found.how[1] == how and bool(inside(found, 1).any()) == bool(words)


def test_a_candidate_that_is_not_there_is_told_and_the_last_one_taken():
    found = select_masks(IMAGES, Selection(words="box", candidate=7), Unsure())
    assert any("--candidate 7: there are 3" in text for text in found.warnings)


class Whole(Squares):
    """Knows the word 'bike': large, and as sure as told; a click alone finds a small part."""

    def __init__(self, confidence=0.3):
        super().__init__()
        self.confidence = confidence

    def words(self, image, text):
        if text == SUBJECT:
            return super().words(image, text)
        return self.bike() if text == "bike" else None

    def bike(self):
        return (Proposal(square(4, 4, 16), self.confidence),)


def test_what_is_hardly_sure_was_not_found():
    words = Selection(words="bike")
    assert select_masks(IMAGES, words, Whole(0.06)).how[0] == "words"
    unsure = select_masks(IMAGES, words, Whole(0.04))
    assert unsure.how[0] == "guess" and "was not found on photo 1" in unsure.warnings[0]


@pytest.mark.parametrize(
    "words, place, confidence, expected, fits",
    [
        # the bike, of which a click finds a part
        ("bike", (0.4, 0.4), 0.3, square(4, 4, 16), True),
        # too unsure to be believed
        ("bike", (0.4, 0.4), 0.2, square(9, 12), None),
        # not on what is called a bike, unsurely and surely
        ("bike", (0.7, 0.7), 0.3, square(16, 22), None),
        ("bike", (0.7, 0.7), 0.9, square(16, 22), False),
        # a word that nobody knows
        ("zorb", (0.7, 0.7), 0.9, square(16, 22), None),
    ],
)
def test_words_say_how_far_goes_what_is_clicked_on_and_whether_they_fit(
    words, place, confidence, expected, fits
):
    marks = Selection(positive=((0, *place),), words=words)
    selected = select_masks(IMAGES, marks, Whole(confidence))
    assert selected.how[0] == "marked" and selected.fits is fits
    assert (inside(selected, 0) == expected.bool()).all()
    told = any("'bike' was found elsewhere" in one for one in selected.warnings)
    assert told == (fits is False)


def test_of_two_marked_photos_the_first_says_whether_the_words_fit():
    marks = Selection(positive=((0, 0.4, 0.4), (1, 0.7, 0.7)), words="bike")
    assert select_masks(IMAGES, marks, Whole(0.9)).fits is True


@pytest.mark.parametrize("words, way", [("bike", "words"), ("zorb", "guess")])
def test_what_is_not_the_thing_leaves_it_what_words_found_or_what_stands_out(
    words, way
):
    beside = Selection(words=words, negative=((0, 0.165, 0.22),))
    selected = select_masks(IMAGES, beside, Whole())
    assert selected.how[0] == way and not inside(selected, 0)[5:7, 5:7].any()


def test_what_the_words_name_is_one_more_candidate_of_a_click():
    class Smaller(Whole):
        """The word's own thing is a part of what the click takes."""

        def bike(self):
            return (Proposal(square(9, 11), self.confidence),)

    marks = Selection(positive=((0, 0.4, 0.4),), words="bike")
    selected = select_masks(IMAGES, marks, Smaller())
    assert (inside(selected, 0) == square(9, 12).bool()).all()
    named = selected.candidates[-1]
    assert named.score == selected.candidates[0].score
    asked = select_masks(IMAGES, replace(marks, candidate=named.number), Smaller())
    assert (inside(asked, 0) == square(9, 11).bool()).all()


@pytest.mark.parametrize(
    "named, taken",
    [
        (square(9, 12, 4), square(9, 12, 4)),  # a fox, before the fox with its plaque
        (square(9, 12, 7), square(9, 12, 6)),  # a bear with its plinth, after the bear
    ],
)
def test_of_the_candidates_of_a_click_a_name_takes_a_smaller_one_and_no_larger(
    named, taken
):
    class Several(Whole):
        def masks(self, image, clicks, box=None, before=None):
            found = answer(*(square(9, 12, size) for size in (6, 4, 7)))
            return replace(found, quality=torch.tensor([0.95, 0.5, 0.5]))

        def bike(self):
            return (Proposal(named, self.confidence),)

    marks = Selection(positive=((0, 0.4, 0.4),), words="bike")
    selected = select_masks(IMAGES, marks, Several())
    assert (inside(selected, 0) == taken.bool()).all()


def test_further_clicks_correct_what_the_words_say():
    marks = Selection(
        positive=((0, 0.4, 0.4),), negative=((0, 0.5, 0.7),), words="bike"
    )
    selected = select_masks(IMAGES, marks, Whole())
    expected = square(4, 4, 16) * (1 - square(16, 16))
    assert (inside(selected, 0) == expected.bool()).all()


@pytest.mark.parametrize(
    "more", [{"larger": -1}, {"boxes": {0: (0.4, 0.4, 0.2, 0.2)}}, {"words": ""}]
)
def test_a_box_a_step_or_no_words_leave_a_click_alone(more):
    asked = {"positive": ((0, 0.4, 0.4),), "words": "bike", **more}
    selected = select_masks(IMAGES, Selection(**asked), Whole())
    assert (inside(selected, 0) == square(9, 12).bool()).all()


def test_a_click_that_means_what_the_words_mean_keeps_its_own_outline():
    class Agreeing(Whole):
        def at(self, row, column, box):
            return square(4, 4, 15)

    marks = Selection(positive=((0, 0.4, 0.4),), words="bike")
    selected = select_masks(IMAGES, marks, Agreeing())
    assert (inside(selected, 0) == square(4, 4, 15).bool()).all()


def test_a_larger_candidate_of_words_is_one_of_their_box():
    areas = [
        inside(select_masks(IMAGES, Selection(words="box", larger=steps), Unsure()), 0)
        for steps in (-9, 9)
    ]
    assert torch.equal(areas[0], square(1, 1, 12).bool())
    assert torch.equal(areas[1], square(1, 1, 22).bool())


def test_without_geometry_a_segmenter_that_follows_nothing_leaves_the_rest_to_masks():
    class Still(Squares):
        def track(self, images, masks):
            return None

    found = select_masks(IMAGES, Selection(positive=((0, 0.25, 0.5),)), Still())
    assert found.how == ("marked", "not found", "not found")
    assert any("--mask" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("marks", "told"),
    [
        ({"positive": ((0, 320, 240),)}, r"outside photo 1: \(320, 240\); .*x / width"),
        ({"negative": ((1, 0.5, -0.1),)}, "outside photo 2"),
        ({"positive": (0, 0.5, 0.4)}, r"a point is \(view, x, y\), got 0"),
        ({"positive": ((0.5, 0.4),)}, r"a point is \(view, x, y\), got \(0.5, 0.4\)"),
        ({"boxes": {0: (10, 10, 200, 100)}}, "box on photo 1 .*x / width"),
        ({"boxes": {0: (0.1, 0.1, 0.0, 0.2)}}, "a size above 0"),
        ({"boxes": {0: (0.1, 0.1, 0.2)}}, "a box is .*x, y, width, height"),
    ],
)
def test_wrong_marks_are_an_error_where_they_are_written(marks, told):
    with pytest.raises(InputError, match=told):
        Selection(**marks)
