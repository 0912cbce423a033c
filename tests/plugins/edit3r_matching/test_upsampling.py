import numpy as np
from edit3r_matching.filling import upsample


def test_a_pixel_unlike_all_its_neighbours_still_gets_their_depth():
    """Its likeness to each of them is smaller than any float; the depth once came out as 0."""
    guide = np.zeros((4, 4, 3), np.float32)
    photo = np.ones((16, 16, 3), np.float32)
    inverse, trust = upsample(np.full((4, 4), 0.5, np.float32), np.ones((4, 4), bool), guide, photo)
    np.testing.assert_allclose(inverse, 0.5, rtol=1e-5)
    np.testing.assert_allclose(trust, 1, rtol=1e-5)
