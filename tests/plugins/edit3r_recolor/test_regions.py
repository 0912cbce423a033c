from types import SimpleNamespace

import pytest
import torch
from edit3r_recolor.regions import (
    ProposalFilter,
    active_objects,
    kept_proposals,
    overlap_ratio,
    processed_views,
    proposals_of_masks,
    soft_masks,
    tracks_of_masks,
)

from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import Tracks
from edit3r.contract.settings import make_settings

CRITERIA = ProposalFilter(
    min_area=0.1, min_stability=0.9, min_predicted_iou=0.8, aspect=(0.8, 3.0), margin=3
)
SIZE = (40, 60)


def _proposal(
    area=0.1, stability=0.9, predicted_iou=0.8, box=(3.0, 3.0, 20.0, 10.0)
) -> SimpleNamespace:
    return SimpleNamespace(
        area=area, stability=stability, predicted_iou=predicted_iou, box=box
    )


@pytest.mark.parametrize("box", [(3.0, 3.0, 30.0, 10.0), (3.0, 3.0, 10.0, 12.5)])
def test_a_proposal_on_every_threshold_passes(box):
    assert CRITERIA.objection(_proposal(box=box), SIZE) is None


@pytest.mark.parametrize(
    ("change", "objection"),
    [
        ({"area": 0.099}, "area"),
        ({"stability": 0.899}, "stability"),
        ({"predicted_iou": 0.799}, "predicted IoU"),
        ({"box": (3.0, 3.0, 30.1, 10.0)}, "aspect"),
        ({"box": (3.0, 3.0, 10.0, 12.6)}, "aspect"),
        ({"box": (3.0, 3.0, 10.0, 0.0)}, "aspect"),
        ({"box": (2.0, 3.0, 20.0, 10.0)}, "margin"),
        ({"box": (3.0, 2.0, 20.0, 10.0)}, "margin"),
        ({"box": (38.0, 3.0, 20.0, 10.0)}, "margin"),
        ({"box": (3.0, 28.0, 20.0, 10.0)}, "margin"),
    ],
)
def test_each_criterion_refuses_what_is_just_beyond_it(change, objection):
    assert CRITERIA.objection(_proposal(**change), SIZE) == objection


def test_order_is_kept_and_refusals_are_counted_by_criterion():
    first, second = _proposal(area=0.5), _proposal(area=0.2)
    given = [
        first,
        _proposal(area=0.01),
        second,
        _proposal(stability=0),
        _proposal(area=0.02),
    ]
    kept, rejected = kept_proposals(given, SIZE, CRITERIA)
    assert kept == [first, second]
    assert rejected == {"area": 2, "stability": 1}


def test_an_aspect_range_upside_down_is_refused():
    with pytest.raises(SettingsError, match=r"recolor\.filter\.aspect"):
        make_settings(ProposalFilter, {"aspect": (3, 2)}, where="recolor.filter")


def _shown(*rows: str) -> torch.Tensor:
    return torch.tensor([[letter == "x" for letter in row] for row in rows])


def test_overlap_ratio_divides_by_the_larger_set():
    one, other = _shown("xx..", "xxxx")
    assert overlap_ratio(one, other) == overlap_ratio(other, one) == 0.5
    assert overlap_ratio(*_shown("....", "....")) == 0


@pytest.mark.parametrize(
    ("shown", "used"),
    [
        # 1 shares one of three with 0; 2 all with 1, but one of three with 0; 3 two of three
        (("xxx..", "x..xx", "x..x.", "xx...", "xx..x"), [0, 3, 4]),
        # 3 shares half with 1 and nothing with 0; 2 and 4, which are alike, one of three
        (("xx...", ".xx..", "x..xx", "..xx.", "x..xx"), [0, 1, 3]),
    ],
)
def test_a_view_is_compared_with_the_most_recently_processed_one(shown, used):
    """Not with its neighbour, the first or the last one that was left out."""
    assert processed_views(_shown(*shown)) == used


def test_objects_are_active_where_a_logit_is_above_zero():
    logits = torch.full((2, 2, 3, 3), -1.0)
    logits[0, 0, 1, 1] = 0.1
    logits[1, 1, 1, 1] = 0.0
    present = torch.ones(2, 2, dtype=torch.bool)
    assert active_objects(Tracks(logits, present)).tolist() == [
        [True, False],
        [False, False],
    ]


def test_masks_are_zero_where_faint_and_where_the_object_is_not():
    logits = torch.tensor([2.0, 0.0, -6.0]).reshape(1, 1, 1, 3).repeat(2, 2, 1, 1)
    present = torch.tensor([[True, True], [True, False]])
    masks = soft_masks(Tracks(logits, present))
    assert masks.shape == (2, 2, 1, 3)
    assert masks[0, 0, 0, 2] == 0 and 0 < masks[0, 0, 0, 1] < masks[0, 0, 0, 0] < 1
    assert not masks[1, 1].any()


def test_given_masks_come_back_in_eight_bits():
    masks = torch.linspace(0, 1, 256).round(decimals=6).reshape(1, 1, 16, 16)
    masks = (masks * 255).round() / 255
    back = (soft_masks(tracks_of_masks(masks)) * 255).round() / 255
    visible = masks > 0.01
    assert torch.equal(back[visible], masks[visible]) and not back[~visible].any()


def test_proposals_of_masks_know_area_and_box():
    mask = torch.zeros(1, 10, 20)
    mask[0, 2:5, 4:12] = 1
    (proposal,) = proposals_of_masks(mask)
    assert proposal.box == (4, 2, 8, 3) and abs(proposal.area - 24 / 200) < 1e-6
    assert proposals_of_masks(torch.zeros(1, 4, 4))[0].box == (0, 0, 0, 0)
