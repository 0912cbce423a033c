"""Marks on one photo are answered by the sum where a segmenter has several masks for them."""

import numpy as np
import pytest
import torch
from edit3r_select.answering import answered, changed_at, standing_out
from edit3r_select.by_segmenter import select_masks
from edit3r_select.cues import Asked, Pool
from edit3r_select.marks import Marks

from edit3r.contract.interfaces import (
    SUBJECT,
    MaskLogits,
    Proposal,
    Segmenter,
    Selection,
    Tracks,
)

HEIGHT, WIDTH = 48, 64
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH] + 0.5
DISC = np.hypot(COLUMNS - 32, ROWS - 24) < 12
CENTRE = (0.5, 0.5)


@pytest.fixture(scope="module")
def image():
    """A disc that is told by its colour."""
    inside = torch.from_numpy(DISC).float()
    return torch.stack((0.2 + 0.6 * inside, 0.7 - 0.5 * inside, 0.3 + 0 * inside))


class Plain(Segmenter):
    """Has one mask for marks, all of the photo, and cannot tell how good it is."""

    def masks(self, image, clicks, box=None, before=None):
        return MaskLogits(torch.ones_like(image[:1]))


class Discs(Plain):
    """Has discs around the last click too; remembers what it was asked."""

    def __init__(self):
        self.asked = []

    def masks(self, image, clicks, box=None, before=None):
        self.asked.append((len(clicks), box is not None, before is not None))
        x, y = clicks[-1][0] if clicks else CENTRE
        away = np.hypot(COLUMNS - x * WIDTH, ROWS - y * HEIGHT)
        logits = np.stack([radius - away for radius in (12.0, 8.0, 12.0, 20.0)])
        return told(logits, [0.9, 0.6, 0.9, 0.2])

    def track(self, images, masks):
        seen = torch.ones(len(images), len(masks), dtype=torch.bool)
        return Tracks((8 * masks - 4).repeat(len(images), 1, 1, 1), seen)


def told(logits, quality):
    return MaskLogits(torch.from_numpy(np.float32(logits)), torch.tensor(quality))


def candidates(segmenter, image, marks):
    return answered(segmenter, image, marks).candidates


def inside(found):
    return found.soft_mask.numpy() > 0.5


def overlap(one, other):
    return (one & other).sum() / (one | other).sum()


def test_a_click_takes_the_mask_that_the_sum_prefers_and_shows_the_others(image):
    segmenter = Discs()
    found = candidates(segmenter, image, Marks(positive=(CENTRE,)))
    assert overlap(inside(found[0]), DISC) > 0.9
    assert len(found) == 3  # of the two that are alike only one
    assert sum(one.confidence for one in found) == pytest.approx(1)


def test_a_selection_is_as_sure_as_its_marks_and_exact_ones_say_nothing(image):
    disc, box = torch.from_numpy(DISC).float(), (0.3, 0.25, 0.4, 0.5)
    less = answered(Discs(), image, Marks(positive=(CENTRE,))).confidence
    more = answered(Discs(), image, Marks(box=box)).confidence
    assert less < more

    def confidence(segmenter, photos=1, **marks):
        views = image.repeat(photos, 1, 1, 1)
        return select_masks(views, Selection(**marks), segmenter).confidence

    click = ((0, *CENTRE),)
    assert confidence(Discs(), positive=click) == less
    assert confidence(Discs(), 2, positive=click, boxes={1: box}) == more
    assert confidence(Discs(), masks={0: disc}) is None
    confirmed = {"positive": click, "masks": {1: disc}}
    assert confidence(Discs(), 2, **confirmed) is None
    assert confidence(Discs(), positive=click, larger=1) is None  # somebody looked
    assert confidence(Plain(), positive=click) is None  # it cannot tell


def test_steps_go_through_the_candidates_by_size(image):
    segmenter = Discs()
    areas = [
        inside(candidates(segmenter, image, Marks((CENTRE,), larger=steps))[0]).sum()
        for steps in (-1, 0, 1)
    ]
    assert areas == sorted(areas) and areas[0] < 0.5 * areas[1] < 0.4 * areas[2]


def test_each_click_is_asked_with_the_answer_before_it_and_all_are_obeyed(image):
    network = Discs()
    marks = Marks(positive=(CENTRE, (0.9, 0.5)), negative=((0.5, 0.3),))
    asked = Selection(
        positive=tuple((0, *place) for place in marks.positive),
        negative=tuple((0, *place) for place in marks.negative),
    )
    mask = select_masks(image[None], asked, network).masks[0, 0].numpy() > 0.5
    assert network.asked[0] == (1, False, False) and (2, False, True) in network.asked
    held = [mask[int(y * HEIGHT), int(x * WIDTH)] for x, y in marks.positive]
    assert all(held) and not mask[int(0.3 * HEIGHT), WIDTH // 2]


class FarBetterInTheMiddle(Plain):
    """A click at the rim brings half of the disc, one in the middle of that the whole."""

    def __init__(self):
        self.asked = []

    def masks(self, image, clicks, box=None, before=None):
        self.asked.append((clicks, before))
        shown = DISC if len(clicks) > 1 else DISC & (COLUMNS < 32)
        return told(
            np.where(shown, 4.0, -4.0)[None], [0.95 if len(clicks) > 1 else 0.6]
        )


def test_a_first_click_is_asked_again_in_the_middle_of_what_it_found(image):
    network, rim = FarBetterInTheMiddle(), (0.37, 0.55)
    found = candidates(network, image, Marks(positive=(rim,)))
    assert overlap(inside(found[0]), DISC) > 0.95
    (first, _), (second, before) = network.asked
    assert first == [(rim, True)] and second[0] == (rim, True)
    (x, y), wanted = second[1]
    assert wanted and np.hypot(x * WIDTH - 26, y * HEIGHT - 24) < 3
    assert (before > 0).sum() < 0.6 * DISC.sum()  # what the first click found


class OneBesideTheOther(Plain):
    """All of the photo; once a click lies outside the left half, so that it is obeyed."""

    def __init__(self):
        self.asked = []

    def masks(self, image, clicks, box=None, before=None):
        self.asked.append(tuple(wanted for _, wanted in clicks))
        left = np.where(COLUMNS < 32, 4.0, -4.0).astype(np.float32)
        whole = np.full_like(left, 4.0)
        outside = not all(wanted for _, wanted in clicks)
        return told(np.stack([left, left] if outside else [whole, whole]), [1.0, 1.0])


@pytest.mark.parametrize(
    ("left", "expected"),
    [
        # beside a change at the click the answer gained something far from it
        (20, np.s_[10:40, 25:50]),
        # it is largely another thing
        (40, None),
    ],
)
def test_a_further_click_changes_what_hangs_together_with_it(left, expected):
    before, after, wanted = (np.full((HEIGHT, WIDTH), -4.0) for _ in range(3))
    before[10:40, 20:50] = 4
    after[10:40, left + 5 : 50] = 4
    after[:4, :4] = 4
    if expected is None:
        wanted = after
    else:
        wanted[expected] = 4
    asked = Asked((((22.5 / WIDTH, 0.5), False),), before=before)
    made = changed_at(Pool(asked, np.stack([after, before]), np.ones(2)))
    assert (made.masks[0] == (wanted > 0)).all()
    # the one that changed nothing is no other, but for a dot that obeys
    assert (made.masks[1] != (before > 0)).sum() < 10


def test_a_click_that_says_nothing_new_is_asked_about_only_once_it_is_disobeyed(image):
    network = OneBesideTheOther()
    marks = Marks(positive=((0.2, 0.5), (0.4, 0.2)), negative=((0.8, 0.5),))
    mask = inside(candidates(network, image, marks)[0])
    assert (True, False) in network.asked  # the second click inside came with neither
    assert all(len(one) < 3 for one in network.asked)
    assert mask[:, :30].all() and not mask[:, 34:].any()


def test_a_click_that_says_what_is_known_changes_nothing(image):
    network = Discs()
    prior = torch.from_numpy(DISC).float()
    marks = Marks(positive=(CENTRE,), negative=((0.9, 0.9),), prior=prior)
    mask = inside(candidates(network, image, marks)[0])
    assert not network.asked and overlap(mask, DISC) > 0.97


@pytest.mark.parametrize(
    ("marks", "asked"),
    [
        (Marks(box=(0.3, 0.25, 0.4, 0.5)), [(0, True, False)]),
        (Marks(stroke=((0.45, 0.5), (0.55, 0.5))), [(2, False, False)]),
    ],
)
def test_a_box_and_a_stroke_are_asked_first(image, marks, asked):
    network = Discs()
    assert candidates(network, image, marks)[0].area > 0
    assert network.asked[:1] == asked


def test_a_large_photo_is_answered_at_its_own_size(image):
    large = torch.nn.functional.interpolate(image[None], (960, 1280))[0]
    found = candidates(Discs(), large, Marks(positive=(CENTRE,)))[0]
    assert found.soft_mask.shape == (960, 1280)
    assert found.area == pytest.approx(DISC.mean(), rel=0.05)


class Salient(Discs):
    """The right half is salient."""

    def words(self, image, text):
        right = torch.from_numpy(np.float32(COLUMNS > WIDTH / 2))
        return (Proposal(right),) if text == SUBJECT else None


def test_what_stands_out_lies_where_it_is_salient_and_the_next_is_another_thing(image):
    first, second, *_ = (inside(one) for one in standing_out(Salient(), image))
    assert first[:, WIDTH // 2 :].sum() > 0.8 * first.sum()
    assert overlap(first, second) < 0.5
    assert standing_out(Discs(), image)  # nothing is salient, and there are things


def test_where_nobody_tells_how_good_masks_are_what_is_salient_stands_out(image):
    class Alone(Salient):
        masks = Plain.masks

    assert standing_out(Alone(), image)[0].area == 0.5
