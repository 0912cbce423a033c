import pytest
import torch

from edit3r.kit.geometry.maps import dilate, dilate_softly


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
