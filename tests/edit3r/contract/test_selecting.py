"""What segmenters are asked with."""

import pytest
import torch

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Selection


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"candidate": 0}, "candidate: got 0"),
        ({"candidate": 1.5}, "candidate: got 1.5"),
        ({"larger": 0.5}, "larger"),
        ({"grow": float("nan")}, "grow: got nan"),
        ({"grow": 1e9}, r"grow: got 1e\+09"),
        ({"words": 5}, "words: got 5"),
        ({"positive": ((1.5, 0.5, 0.5),)}, "view 1.5"),
        ({"strokes": ((0, ((0.5, 0.5),)), (1, ()))}, "photo 2 has no place"),
        ({"masks": {"left": torch.ones(2, 2)}}, "view 'left'"),
        ({"masks": {0: [[1]]}}, "a list"),
        ({"added": {0: torch.ones(1, 2, 2)}}, r"shape \[1, 2, 2\]"),
        ({"removed": {0: torch.full((2, 2), 255.0)}}, "values from 255"),
        ({"masks": {0: torch.ones(2, 2), 1: torch.ones(2, 3)}}, "2x2, 3x2"),
    ],
)
def test_a_selection_that_cannot_be_meant_is_one_sentence(given, told):
    with pytest.raises(InputError, match=told):
        Selection(**given)
