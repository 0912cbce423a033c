"""What several plugins ask of a segmenter, by closed forms."""

import pytest
import torch

from edit3r.contract.interfaces import MaskLogits, Proposal, Segmenter
from edit3r.contract.reporting import Report, collecting
from edit3r.kit import segmenting

SIZE = 32
PHOTO = torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))


class Discs(Segmenter):
    """A small and a large disc around the first click or the middle of a box."""

    def __init__(self, quality=(0.6, 0.9)):
        self.quality = None if quality is None else torch.tensor(quality)

    def masks(self, image, clicks, box=None, before=None):
        x, y = clicks[0][0] if clicks else (box[0] + box[2] / 2, box[1] + box[3] / 2)
        grid = (torch.arange(SIZE) + 0.5) / SIZE
        away = torch.hypot(grid[None] - x, grid[:, None] - y)
        logits = torch.stack([40 * (radius - away) for radius in (0.1, 0.2)])
        return MaskLogits(logits, self.quality)


def width_of(mask):
    return Proposal(mask).box[2]


def test_the_mask_in_a_box_is_the_best_or_the_first_where_nobody_tells():
    box = (0.3, 0.3, 0.4, 0.4)
    best = segmenting.mask_in_box(Discs(), PHOTO, box)
    first = segmenting.mask_in_box(Discs(None), PHOTO, box)
    assert width_of(best) == pytest.approx(0.4 * SIZE, abs=2)
    assert width_of(first) == pytest.approx(0.2 * SIZE, abs=2)


def test_everything_on_an_image_is_found_by_a_grid_of_clicks_best_first():
    events = []
    with collecting(Report(on_event=lambda *event: events.append(event))):
        found = segmenting.automatic_masks(Discs(), PHOTO, 3)
    assert ("progress", "segmenting", 9, 9) in events
    assert [one.predicted_iou for one in found[:9]] == pytest.approx([0.9] * 9)
    assert len(found) == 18  # a small one has not the box of a large one
    assert all(0 < one.stability < 1 and one.area > 0 for one in found)


def test_what_is_not_good_or_stable_enough_is_no_thing():
    large = segmenting.automatic_masks(Discs(), PHOTO, 3, min_predicted_iou=0.8)
    assert [one.predicted_iou for one in large] == pytest.approx([0.9] * 9)
    bound = large[0].stability - 1e-3
    stable = segmenting.automatic_masks(Discs(), PHOTO, 3, min_stability=bound)
    assert 0 < len(stable) <= 9 and min(one.stability for one in stable) >= bound
    unknown = segmenting.automatic_masks(Discs(None), PHOTO, 1)
    assert unknown[0].predicted_iou == segmenting.UNKNOWN_QUALITY


def cone(radius: float, slope: float = 1.0, size: int = 101) -> torch.Tensor:
    """Logits that fall by `slope` a pixel from the centre and are 0 at `radius`."""
    y, x = torch.meshgrid(
        torch.arange(size) - size // 2, torch.arange(size) - size // 2, indexing="ij"
    )
    return (radius - torch.hypot(x.float(), y.float())) * slope


def test_stability_of_a_cone_is_the_ratio_of_two_discs():
    logits = torch.stack((cone(20.0), cone(40.0), cone(20.0, slope=0.1)))
    expected = torch.tensor([(19 / 21) ** 2, (39 / 41) ** 2, (10 / 30) ** 2])
    assert torch.allclose(segmenting.stability(logits), expected, atol=0.03)


def test_a_sharp_mask_is_fully_stable_and_an_empty_one_not_at_all():
    sharp = torch.where(cone(20.0) > 0, 8.0, -8.0)
    assert segmenting.stability(
        torch.stack((sharp, torch.full_like(sharp, -8)))
    ).tolist() == [
        1.0,
        0.0,
    ]


def test_boxes_are_x_y_width_height_in_pixels():
    inside = torch.zeros(3, 10, 20, dtype=torch.bool)
    inside[0, 2:5, 7:15] = True
    inside[1, 9, 19] = True
    assert segmenting.boxes_of(inside).tolist() == [
        [7, 2, 8, 3],
        [19, 9, 1, 1],
        [0, 0, 0, 0],
    ]


def test_of_boxes_that_overlap_more_than_allowed_the_best_stays():
    boxes = torch.tensor(
        [[0, 0, 10, 10], [1, 0, 10, 10], [30, 30, 5, 5], [0, 0, 10, 6.0]]
    )
    scores = torch.tensor([0.8, 0.9, 0.5, 0.7])
    # IoU of the first two is 9/11, of the first and last 0.6, of the second and last 54/106.
    assert segmenting.best_boxes(boxes, scores, 0.7) == [1, 3, 2]
    assert segmenting.best_boxes(boxes, scores, 0.5) == [1, 2]
    assert segmenting.best_boxes(boxes, scores, 0.9) == [1, 0, 3, 2]
    assert segmenting.best_boxes(boxes[:0], scores[:0], 0.7) == []


def test_enlarging_keeps_the_order_of_masks_and_constants():
    logits = torch.arange(6.0).view(2, 3, 1, 1).expand(2, 3, 4, 4)
    large = segmenting.enlarged(logits, (7, 9))
    assert large.shape == (2, 3, 7, 9)
    assert torch.equal(large[..., 0, 0], torch.arange(6.0).view(2, 3))
