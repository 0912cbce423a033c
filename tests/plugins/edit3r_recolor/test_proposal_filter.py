import pytest
import torch
from edit3r_recolor.proposal_filter import ProposalFilter, kept_proposals

from edit3r.config import make_settings
from edit3r.errors import SettingsError
from edit3r.interfaces import Proposal

CRITERIA = ProposalFilter(min_area=0.1, min_stability=0.9, min_predicted_iou=0.8, aspect=(0.5, 2.0), margin=3)
SIZE = (40, 60)


def _proposal(area=0.1, stability=0.9, predicted_iou=0.8, box=(3.0, 3.0, 20.0, 10.0)) -> Proposal:
    return Proposal(torch.zeros(SIZE), area, stability, predicted_iou, box)


def test_a_proposal_on_every_threshold_passes():
    assert CRITERIA.objection(_proposal(), SIZE) is None


@pytest.mark.parametrize(
    ("change", "objection"),
    [
        ({"area": 0.099}, "area"),
        ({"stability": 0.899}, "stability"),
        ({"predicted_iou": 0.799}, "predicted IoU"),
        ({"box": (3.0, 3.0, 20.1, 10.0)}, "aspect"),
        ({"box": (3.0, 3.0, 4.9, 10.0)}, "aspect"),
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
    given = [first, _proposal(area=0.01), second, _proposal(stability=0), _proposal(area=0.02)]
    kept, rejected = kept_proposals(given, SIZE, CRITERIA)
    assert kept == [first, second]
    assert rejected == {"area": 2, "stability": 1}


def test_an_aspect_range_upside_down_is_refused():
    with pytest.raises(SettingsError, match=r"recolor\.filter\.aspect"):
        make_settings(ProposalFilter, {"aspect": (3, 2)}, where="recolor.filter")
