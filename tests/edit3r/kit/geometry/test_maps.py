import numpy as np
import pytest
import torch

from edit3r.kit.geometry.maps import (
    dilate,
    dilate_softly,
    guided_upsample,
    upsample_depth,
)


def test_maps_at_the_guide_s_size_come_back_unchanged():
    maps = torch.rand(1, 4, 8, 8)
    assert guided_upsample(maps, torch.rand(1, 3, 8, 8)) is maps


def test_constant_maps_stay_constant():
    fine = guided_upsample(torch.full((1, 2, 8, 6), 0.3), torch.rand(1, 3, 32, 24))
    assert torch.allclose(fine, torch.full((1, 2, 32, 24), 0.3), atol=1e-4)


def test_a_step_follows_the_guide_s_edge_better_than_bilinear_resizing():
    guide = torch.zeros(1, 3, 64, 64)
    guide[..., 30:] = 1.0  # not on the coarse grid's lines
    truth = guide[:, :1]
    coarse = torch.nn.functional.interpolate(truth, (16, 16), mode="area")
    guided = (guided_upsample(coarse, guide) - truth).abs().mean()
    plain = torch.nn.functional.interpolate(
        coarse, (64, 64), mode="bilinear", align_corners=False
    )
    assert guided < 0.35 * (plain - truth).abs().mean()


def test_the_result_stays_within_the_neighbourhood_s_range():
    torch.manual_seed(0)
    maps = torch.rand(1, 3, 8, 8)
    fine = guided_upsample(maps, torch.rand(1, 3, 40, 40))
    assert fine.min() >= maps.min() - 1e-5 and fine.max() <= maps.max() + 1e-5


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


@pytest.mark.parametrize("shape", [(7, 9), (3, 7, 9), (2, 3, 7, 9)])
@pytest.mark.parametrize("reach", [0, 1, 4])
def test_it_is_the_largest_of_the_square_inside_the_picture(shape, reach):
    # beyond the border is not 0
    maps = torch.randn(shape, generator=torch.Generator().manual_seed(reach)) - 5
    found = dilate(maps, reach)
    assert found.shape == maps.shape
    for row in range(7):
        for column in range(9):
            square = maps[
                ...,
                max(0, row - reach) : row + reach + 1,
                max(0, column - reach) : column + reach + 1,
            ]
            assert torch.equal(found[..., row, column], square.amax((-2, -1)))


def test_a_mask_grows_softly_and_ends():
    mask = torch.zeros(1, 50, 200)
    mask[:, 20:30, 80:120] = 1
    soft = dilate_softly(mask)
    assert (soft[mask > 0] == 1).all() and soft[0, 25, 122] > 0
    assert soft[0, 25, 130:].max() == 0 and soft[0, :10].max() == 0
