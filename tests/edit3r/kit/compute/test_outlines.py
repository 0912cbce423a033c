import numpy as np
import pytest
import torch

from edit3r.kit.compute.outlines import overlap


@pytest.mark.parametrize("form", [np.array, torch.tensor])
def test_overlap_is_the_shared_part_of_both(form):
    left, right = form([[True, True, False]]), form([[False, True, False]])
    assert overlap(left, right) == 0.5
    assert overlap(left, ~left) == 0 and overlap(left & ~left, right & ~right) == 0
