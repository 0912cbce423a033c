import numpy as np
from edit3r_geometry.upsampling import upsample_depth


def test_a_pixel_unlike_all_its_neighbours_still_gets_their_depth():
    """Its likeness to each of them is smaller than any float; the depth once came out as 0."""
    guide = np.zeros((4, 4, 3), np.float32)
    image = np.ones((16, 16, 3), np.float32)
    inverse, confidence = upsample_depth(
        np.full((4, 4), 0.5, np.float32), np.ones((4, 4), bool), guide, image
    )
    np.testing.assert_allclose(inverse, 0.5, rtol=1e-5)
    np.testing.assert_allclose(confidence, 1, rtol=1e-5)


def test_enlarging_keeps_depth_edges_where_the_image_has_them():
    image = np.zeros((96, 128, 3), np.float32)
    image[:, 65:] = 1  # the edge lies inside a small pixel
    small = image.reshape(48, 2, 64, 2, 3).mean((1, 3))
    inverse = np.where(small[..., 0] > 0.5, np.float32(0.5), np.float32(0.1))
    depth, trust = upsample_depth(inverse, np.ones((48, 64), bool), small, image)
    assert set(np.unique(depth.round(4))) == {np.float32(0.1), np.float32(0.5)}
    assert (depth[:, :64] < 0.2).all() and (depth[:, 66:] > 0.4).all()
    assert np.allclose(trust, 1)


def test_enlarging_a_slope_keeps_it_smooth():
    x = np.arange(64, dtype=np.float32)
    inverse = np.broadcast_to(0.2 + 0.0005 * x, (48, 64)).astype(np.float32).copy()
    depth, _ = upsample_depth(
        inverse,
        np.ones((48, 64), bool),
        np.zeros((48, 64, 3), np.float32),
        np.zeros((96, 128, 3)),
    )
    expected = 0.2 + 0.0005 * np.clip((np.arange(128) + 0.5) / 2 - 0.5, 0, 63)
    assert np.abs(depth - expected).max() < 1e-5
