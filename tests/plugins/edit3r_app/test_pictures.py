"""Pictures of what may be meant on a photo, and the marks that take it."""

import pytest
import torch
from edit3r_app.pictures import around


def test_the_lasso_around_a_candidate_lies_where_it_does_on_a_wide_photo():
    mask = torch.zeros(20, 60)
    mask[5:10, 30:50] = 1
    x, y = zip(*around(mask, "a").places)
    assert (min(x), max(x)) == pytest.approx((30 / 60, 49 / 60))
    assert (min(y), max(y)) == pytest.approx((5 / 20, 9 / 20))
