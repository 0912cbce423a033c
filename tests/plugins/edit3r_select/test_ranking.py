"""Which mask is taken, and how sure that is."""

import numpy as np
import pytest
import yaml
from edit3r_select.answering import gathered, selected
from edit3r_select.cues import CUES, Asked, Pool
from edit3r_select.ranking import ALONE, FITTED, CueWeights, choose, fitted, lead

SIDE = 100
ROWS, COLUMNS = np.indices((SIDE, SIDE))


def square(reach):
    return (np.abs(ROWS - 50) < reach) & (np.abs(COLUMNS - 50) < reach)


def as_logits(*masks):
    return np.where(np.stack(masks), 3.0, -3.0).astype(np.float32)


SIZE = SIDE, SIDE
KINDS = ["click", "stroke", "box", "carried", "unmarked", "more"]
CLICK = ((0.5, 0.5), True)
BY_QUALITY = CueWeights(
    ("quality",), np.array([10.0]), certainty=np.array([2.0, 1.0, 1.0, -1.0])
)


def pool(masks, quality, clicks=(CLICK,)):
    asked = Asked(clicks=clicks)
    return Pool(asked, as_logits(*masks), np.array(quality))


def test_the_largest_sum_comes_first_and_nearly_equal_masks_once():
    masks = [square(10), square(30), square(30.5), square(40)]
    chosen = choose(pool(masks, [0.5, 0.9, 0.8, 0.7]), BY_QUALITY)
    assert [one.quality for one in chosen.candidates] == [0.9, 0.7, 0.5]
    assert chosen.stepped(1).quality == 0.7 and chosen.stepped(-1).quality == 0.5
    assert chosen.stepped(9) is chosen.stepped(1)


def test_a_longer_lead_is_a_higher_confidence():
    masks = [square(10), square(30)]
    close = choose(pool(masks, [0.85, 0.9]), BY_QUALITY).confidence
    far = choose(pool(masks, [0.4, 0.9]), BY_QUALITY).confidence
    assert 0 < close < far < 1


def test_a_mask_that_the_network_doubts_is_less_sure():
    masks, weights = [square(10), square(30)], fitted("click")
    alike = [choose(pool(masks, [0.2, one]), weights) for one in (0.5, 0.9)]
    assert alike[0].best.mask.sum() == alike[1].best.mask.sum()
    assert alike[0].confidence < alike[1].confidence


def test_the_lead_is_over_a_mask_of_another_size():
    values, areas = np.array([2.0, 1.9, 0.5]), np.array([0.2, 0.21, 0.05])
    assert lead(values, areas) == pytest.approx(1.5)
    assert lead(values[:2], areas[:2]) == ALONE


def test_a_mask_that_misses_a_click_obeys_it_in_the_end():
    beside = ((0.9, 0.9), True), ((0.5, 0.5), False)
    mask = choose(pool([square(20)], [0.9], beside), BY_QUALITY).best.mask
    assert mask[90, 90] and not mask[50, 50]
    assert (mask ^ square(20)).sum() < 20


class Sam:
    """Answers a square around each click, and remembers what it was asked."""

    def __init__(self):
        self.asked = []

    def __call__(self, clicks, box=None, before=None):
        self.asked.append((len(clicks), box is not None, before is not None))
        column, row = (int(SIDE * one) for one in clicks[-1][0]) if clicks else (50, 50)
        reach = np.maximum(np.abs(ROWS - row), np.abs(COLUMNS - column))
        sizes = (8, 12, 20, 30)
        return as_logits(*(reach < one for one in sizes)), np.linspace(0.9, 0.6, 4)


def test_a_click_asks_once_a_stroke_twice_and_a_correction_with_what_was_before():
    sam = Sam()
    assert len(gathered(SIZE, Asked(clicks=(CLICK,)), sam).masks) == 4
    assert sam.asked == [(1, False, False)]
    stroke = tuple((0.3 + 0.02 * n, 0.5) for n in range(20))
    gathered(SIZE, Asked(stroke=stroke), sam)
    assert sam.asked[1:] == [(4, False, False), (1, False, False)]
    del sam.asked[:]
    more = Asked(clicks=(CLICK, ((0.8, 0.5), False)), before=as_logits(square(40))[0])
    found = gathered(SIZE, more, sam)
    assert [one[2] for one in sam.asked] == [False, True, False]
    joined = found.masks[-4:]  # the answer before without the part at the click
    assert not joined[:, 50, 80].any() and joined[:, 50, 20].all()


def test_selecting_uses_the_fitted_weights():
    chosen = selected(SIZE, Asked(clicks=(CLICK,)), Sam())
    assert chosen.best.mask[50, 50] and 0 < chosen.confidence < 1
    untold = selected(
        SIZE, Asked(clicks=(CLICK,)), lambda *a, **k: (Sam()(*a)[0], None)
    )
    assert untold.best.mask.any() and untold.confidence is None


@pytest.mark.parametrize("kind", KINDS)
def test_fitted_weights_are_of_known_cues(kind):
    assert set(fitted(kind).cues) <= set(CUES)
    assert fitted(kind).certainty[0] > 0  # a lead never speaks against the first


def test_the_file_says_how_it_was_made():
    assert "benchmarks/ranking.py" in FITTED.read_text()
    assert set(yaml.safe_load(FITTED.read_text())) == set(KINDS)
