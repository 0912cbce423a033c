"""What is cut out has no crumbs, and no holes but real ones."""

import numpy as np
from edit3r_segmenters.masks import tidied


def test_tidying_drops_crumbs_and_fills_small_holes_only():
    seed = np.zeros((40, 60), bool)
    seed[5:35, 5:35] = True
    mask = seed.copy()
    mask[10:12, 10:12] = False  # a small hole
    mask[15:25, 15:25] = False  # a real one
    mask[2, 50] = True  # a crumb
    mask[10:30, 45:55] = True  # large, but nothing of the seed
    expected = seed.copy()
    expected[15:25, 15:25] = False
    assert np.array_equal(tidied(mask, seed), expected)
