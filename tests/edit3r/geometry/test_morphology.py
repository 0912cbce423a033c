"""The largest value around each pixel, against its definition."""

import pytest
import torch

from edit3r.geometry.morphology import largest_around


@pytest.mark.parametrize("shape", [(7, 9), (3, 7, 9), (2, 3, 7, 9)])
@pytest.mark.parametrize("reach", [0, 1, 4])
def test_it_is_the_largest_of_the_square_inside_the_picture(shape, reach):
    maps = torch.randn(shape, generator=torch.Generator().manual_seed(reach)) - 5  # beyond the border is not 0
    found = largest_around(maps, reach)
    assert found.shape == maps.shape
    for row in range(7):
        for column in range(9):
            square = maps[..., max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
            assert torch.equal(found[..., row, column], square.amax((-2, -1)))
