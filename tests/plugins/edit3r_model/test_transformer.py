"""Rotary positions against rotating each channel pair by hand."""

import math

import torch
from edit3r_model.transformer import make_rotation, patch_positions


def test_pairs_are_half_a_half_apart_and_rows_come_first():
    rotation = make_rotation(torch.tensor([[3, 5]]), head_width=8, base=100.0)
    for channel, partner, angle in [
        (0, 2, 3.0),
        (1, 3, 3 * 100**-0.5),
        (4, 6, 5.0),
        (5, 7, 5 * 100**-0.5),
    ]:
        unit = torch.zeros(1, 1, 1, 8)
        unit[..., channel] = 1
        turned = rotation(unit).flatten()
        expected = torch.zeros(8)
        expected[channel], expected[partner] = math.cos(angle), math.sin(angle)
        torch.testing.assert_close(turned, expected)


def test_scores_depend_on_relative_position_only():
    query, key = (
        torch.randn(1, 1, 1, 16, dtype=torch.float64),
        torch.randn(1, 1, 1, 16, dtype=torch.float64),
    )

    def score(at, other):
        turned = [
            make_rotation(torch.tensor([p]), 16, 100.0)(x)
            for p, x in (((at[0], at[1]), query), ((other[0], other[1]), key))
        ]
        return (turned[0] * turned[1]).sum()

    torch.testing.assert_close(
        score((2, 7), (4, 1)), score((12, 8), (14, 2)), rtol=1e-5, atol=1e-6
    )


def test_the_extra_token_sits_first_in_the_row_below_the_grid():
    assert patch_positions((2, 3), extra_token=True).tolist() == [
        [0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2], [2, 0],
    ]  # fmt: skip


def test_half_precision_input_keeps_its_dtype():
    rotation = make_rotation(patch_positions((2, 2), False), 8, 100.0)
    assert (
        rotation(torch.randn(1, 4, 2, 8, dtype=torch.bfloat16)).dtype == torch.bfloat16
    )
