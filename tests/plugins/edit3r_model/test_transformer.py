"""Rotary positions against rotating each channel pair by hand."""

import math

import torch
from edit3r_model.transformer import make_rotation, patch_positions


def turned(x: torch.Tensor, *place: int) -> torch.Tensor:
    return make_rotation(torch.tensor([place]), x.shape[-1])(x)


def test_pairs_are_half_a_half_apart_and_rows_come_first():
    for first, partner, angle in [
        (0, 2, 3.0),
        (1, 3, 3 * 100**-0.5),
        (4, 6, 5.0),
        (5, 7, 5 * 100**-0.5),
    ]:
        unit, expected = torch.zeros(1, 1, 1, 8), torch.zeros(8)
        unit[..., first] = 1
        expected[first], expected[partner] = math.cos(angle), math.sin(angle)
        torch.testing.assert_close(turned(unit, 3, 5).flatten(), expected)


def test_scores_depend_on_relative_position_only():
    query, key = torch.randn(2, 1, 1, 1, 16, dtype=torch.float64)
    one = (turned(query, 2, 7) * turned(key, 4, 1)).sum()
    other = (turned(query, 12, 8) * turned(key, 14, 2)).sum()
    torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)


def test_the_extra_token_sits_first_in_the_row_below_the_grid():
    expected = [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0]]
    assert patch_positions((2, 2)).tolist() == expected


def test_half_precision_input_keeps_its_dtype():
    x = torch.randn(1, 1, 2, 8, dtype=torch.bfloat16)
    assert turned(x, 0, 1).dtype == torch.bfloat16
