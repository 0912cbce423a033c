import pytest
import torch

from edit3r.kit.geometry.maps import composite, dilate, dilate_softly, feathered


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


def test_a_composite_has_the_very_bits_of_one_picture_where_masks_are_0_and_1():
    pictures = torch.rand(2, 1, 2, 3, 8, 9, generator=torch.Generator().manual_seed(0))
    original, edited = pictures / 3  # whose differences round
    mixed = composite(original, edited, torch.linspace(0, 1, 9).expand(1, 2, 8, 9))
    assert torch.equal(mixed[..., 0], original[..., 0])
    assert torch.equal(mixed[..., 8], edited[..., 8])
    torch.testing.assert_close(mixed[..., 4], (original + edited)[..., 4] / 2)


def test_weights_rise_smoothly_from_the_outline_and_the_border_is_none():
    mask = torch.zeros(1, 20, 40)
    mask[:, :, :20] = 1
    weights = feathered(mask, 10.0)[0]
    assert weights[:, 20:].max() == 0 and (weights[:, :10] == 1).all()
    # slower at both ends than half-way: 3 x^2 - 2 x^3
    expected = torch.tensor([0.104, 0.5, 0.896]).expand(20, 3)
    torch.testing.assert_close(weights[:, [18, 15, 12]], expected, atol=0.03, rtol=0)
