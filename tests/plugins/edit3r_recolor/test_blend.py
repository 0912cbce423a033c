import torch
from edit3r_recolor.blend import EPSILON, blend_regions, renormalize
from hypothesis import given, settings
from hypothesis import strategies as st

GENERATOR = torch.Generator().manual_seed(0)
IMAGE = torch.rand(2, 3, 4, 5, generator=GENERATOR, dtype=torch.float64)
RECOLORED = torch.rand(3, 2, 3, 4, 5, generator=GENERATOR, dtype=torch.float64)


def masks(regions: int) -> torch.Tensor:
    return torch.rand(regions, 2, 4, 5, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def test_blend_follows_the_equation_pixel_by_pixel():
    """I' = sum_r a_r C_r(I) + (1 - sum_r a_r) I, written out as loops."""
    given = masks(3)
    weights = renormalize(given)
    blended = blend_regions(IMAGE, RECOLORED, given)
    for view, channel, row, column in [(0, 0, 0, 0), (1, 2, 3, 4), (0, 1, 2, 2)]:
        alphas = [float(weights[r, view, row, column]) for r in range(3)]
        expected = (1 - sum(alphas)) * float(IMAGE[view, channel, row, column])
        expected += sum(a * float(RECOLORED[r, view, channel, row, column]) for r, a in enumerate(alphas))
        assert abs(float(blended[view, channel, row, column]) - expected) < 1e-12


def test_overlapping_binary_masks_share_a_pixel_evenly():
    overlapping = torch.ones(2, 1, 1, 1, dtype=torch.float64)
    weights = renormalize(overlapping)
    assert torch.allclose(weights, torch.full_like(weights, 1 / (2 + EPSILON)))


def test_a_single_region_is_plain_alpha_blending():
    mask = masks(1)
    expected = mask[0, :, None] * RECOLORED[0] + (1 - mask[0, :, None]) * IMAGE
    assert torch.allclose(blend_regions(IMAGE, RECOLORED[:1], mask), expected, atol=1e-12)


def test_pixels_no_mask_touches_are_bit_equal():
    given = masks(3)
    given[..., :2] = 0
    assert torch.equal(blend_regions(IMAGE, RECOLORED, given)[..., :2], IMAGE[..., :2])


@settings(max_examples=50)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_weights_are_shares_that_sum_to_at_most_one(values):
    weights = renormalize(torch.tensor(values, dtype=torch.float64)[:, None, None, None])
    assert (weights >= 0).all() and weights.sum() <= 1 + 1e-12
    if sum(values) > 1:
        assert weights.sum() > 1 - 2e-6


def test_the_order_of_regions_does_not_matter():
    given = masks(3)
    flipped = blend_regions(IMAGE, RECOLORED.flip(0), given.flip(0))
    assert torch.allclose(flipped, blend_regions(IMAGE, RECOLORED, given), atol=1e-12)
