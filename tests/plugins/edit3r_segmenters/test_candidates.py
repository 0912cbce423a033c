"""The mask generator's fields by closed forms."""

import math

import pytest
import torch
from edit3r_segmenters import candidates


def cone(radius: float, slope: float = 1.0, size: int = 101) -> torch.Tensor:
    """Logits that fall by `slope` a pixel from the centre and are 0 at `radius`."""
    y, x = torch.meshgrid(torch.arange(size) - size // 2, torch.arange(size) - size // 2, indexing="ij")
    return (radius - torch.hypot(x.float(), y.float())) * slope


def test_stability_of_a_cone_is_the_ratio_of_two_discs():
    logits = torch.stack((cone(20.0), cone(40.0), cone(20.0, slope=0.1)))
    expected = torch.tensor([(19 / 21) ** 2, (39 / 41) ** 2, (10 / 30) ** 2])
    assert torch.allclose(candidates.stability(logits), expected, atol=0.03)


def test_a_sharp_mask_is_fully_stable_and_an_empty_one_not_at_all():
    sharp = torch.where(cone(20.0) > 0, 8.0, -8.0)
    assert candidates.stability(torch.stack((sharp, torch.full_like(sharp, -8)))).tolist() == [1.0, 0.0]


def test_boxes_are_x_y_width_height_in_pixels():
    inside = torch.zeros(3, 10, 20, dtype=torch.bool)
    inside[0, 2:5, 7:15] = True
    inside[1, 9, 19] = True
    assert candidates.boxes_of(inside).tolist() == [[7, 2, 8, 3], [19, 9, 1, 1], [0, 0, 0, 0]]


def test_a_proposal_carries_the_sigmoid_of_the_logits_and_the_area_above_a_half():
    logits = cone(20.0)
    proposal = candidates.proposal(logits, 0.9)
    assert torch.equal(proposal.soft_mask, torch.sigmoid(logits))
    assert proposal.soft_mask[50, 50] == torch.sigmoid(torch.tensor(20.0))
    assert proposal.area == pytest.approx((proposal.soft_mask > 0.5).float().mean().item())
    assert proposal.area == pytest.approx(math.pi * 400 / 101**2, rel=0.02)
    assert proposal.predicted_iou == pytest.approx(0.9)
    assert proposal.box == (31.0, 31.0, 39.0, 39.0)


def test_of_boxes_that_overlap_more_than_allowed_the_best_stays():
    boxes = torch.tensor([[0, 0, 10, 10], [1, 0, 10, 10], [30, 30, 5, 5], [0, 0, 10, 6.0]])
    scores = torch.tensor([0.8, 0.9, 0.5, 0.7])
    # IoU of the first two is 9/11, of the first and last 0.6, of the second and last 54/106.
    assert candidates.suppress(boxes, scores, 0.7) == [1, 3, 2]
    assert candidates.suppress(boxes, scores, 0.5) == [1, 2]
    assert candidates.suppress(boxes, scores, 0.9) == [1, 0, 3, 2]
    assert candidates.suppress(boxes[:0], scores[:0], 0.7) == []


def test_predicted_iou_outside_its_range_is_brought_into_it():
    fields = candidates.describe(cone(9.0)[None], cone(9.0)[None], torch.tensor([1.2]))
    assert fields.predicted_iou.item() == 1
