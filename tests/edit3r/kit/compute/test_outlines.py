import numpy as np
import pytest
import torch

from edit3r.kit.compute.outlines import box_around, overlap


@pytest.mark.parametrize("form", [np.array, torch.tensor])
def test_overlap_is_the_shared_part_of_both(form):
    left, right = form([[True, True, False]]), form([[False, True, False]])
    assert overlap(left, right) == 0.5
    assert overlap(left, ~left) == 0 and overlap(left & ~left, right & ~right) == 0


def test_the_box_around_a_mask_has_one_pixel_at_least():
    mask = np.zeros((20, 40), bool)
    assert box_around(mask)[2:] == (1 / 40, 1 / 20)
    mask[3:14, 6:31] = True
    assert box_around(mask) == (6 / 40, 3 / 20, 25 / 40, 11 / 20)
