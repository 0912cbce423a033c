"""`edit3r.select`: masks of all photos from marks on one, without a run."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Candidate, Selected, Selection, Selector
from edit3r.contract.types import Views
from edit3r.running.selecting import call
from edit3r_testing.scenes import photograph


@pytest.mark.slow
def test_masks_of_all_photos_come_at_their_size_with_candidates_in_order_of_size():
    views = photograph(2, (48, 64)).views
    click = Selection(positive=((0, 0.3, 0.55),))
    found = edit3r.select(views, click, segmenter={"name": "grabcut", "learned": False})
    assert found.masks.shape == (1, 2, 48, 64)
    assert found.is_sure and found.confidence is None and "marked" in found.why
    areas = [float((one.mask > 0.5).sum()) for one in found.candidates]
    assert areas == sorted(areas) and {one.number for one in found.candidates} >= {1}
    assert abs(sum(one.score for one in found.candidates)) <= 1.001


@pytest.mark.slow
def test_a_number_chooses_among_the_candidates():
    views = photograph(2, (48, 64)).views
    asked = {"positive": ((0, 0.3, 0.55),)}
    chosen = {"name": "grabcut", "learned": False}
    found = edit3r.select(views, Selection(**asked), segmenter=chosen)
    by_number = {one.number: one.mask for one in found.candidates}
    for number, mask in by_number.items():
        again = edit3r.select(
            views, Selection(**asked, candidate=number), segmenter=chosen
        )
        assert torch.equal(again.masks[0, 0] > 0.5, mask > 0.5)


@pytest.mark.slow
def test_what_one_call_found_is_kept_for_the_next():
    views = photograph(2, (48, 64)).views
    cache = edit3r.Cache()
    for _ in range(2):
        edit3r.select(views, Selection(positive=((0, 0.3, 0.55),)), cache=cache)
    computed = cache.computed.count("match")
    assert computed <= 1 and cache.reused.count("match") == computed


class Bright(Selector):
    """What is brighter than the half; the candidates are the halves, the larger one first."""

    def select(self, views, selection, geometry=None):
        masks = (views.images[0].mean(1, keepdim=True) > 0.5).float()
        left = torch.ones(masks.shape[2:])
        left[:, 5:] = 0
        parts = (Candidate(1, left, 0.7, 1), Candidate(1, 1 - left, 0.2, 2))
        mean = float(masks.mean())
        ways = ("marked", "geometry", "not found")
        return Selected(masks, ways, ("dark",), confidence=mean, candidates=parts)


def test_of_a_batch_each_scene_has_its_masks_and_the_first_one_tells_the_rest():
    images = torch.rand(2, 3, 3, 6, 8)
    images[:, 2] = 0
    views = Views(images, torch.eye(3).expand(2, 3, 3, 3), ("a", "b", "c"))
    marks = Selection(positive=((0, 0.5, 0.5),))
    found = call.select_with(views, marks, Bright(), None)
    assert torch.equal(found.masks, (images.mean(2) > 0.5).float())
    assert [one.number for one in found.candidates] == [2, 1]  # 18 pixels, 30
    assert found.confidence == float(found.masks[0].mean())
    assert found.why == (
        f"a: marked, b: geometry, c: not found; confidence {found.confidence:.0%}"
    )
    assert (found.how[2], found.warnings) == ("not found", ("dark",))
    unnamed = call.select_with(replace(views, names=()), marks, Bright(), None)
    assert unnamed.why.startswith("1: marked, 2: geometry, 3: not")


def test_a_further_call_with_the_same_cache_builds_a_segmenter_only_for_other_settings():
    cache = edit3r.Cache()
    small, large = (
        {"name": "grabcut", "learned": False, "size": size} for size in (64, 96)
    )
    first, again, other = (call._ready(one, cache) for one in (small, small, large))
    assert again is first
    assert other is not first and other.settings.size == 96


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (
            {"selection": Selection(masks={0: torch.ones(3, 4)})},
            r"is \[3, 4\]; expected",
        ),
        ({"segmenter": {"points": 4}}, "has no name"),
        ({"segmenter": 3}, "got int, expected a name"),
    ],
)
def test_what_cannot_be_asked_is_one_sentence(asked, said):
    views = Views(torch.rand(1, 2, 3, 8, 8), torch.eye(3).expand(1, 2, 3, 3))
    given = {"selection": Selection(positive=((0, 0.5, 0.5),)), **asked}
    with pytest.raises(InputError, match=said):
        edit3r.select(views, **given)
