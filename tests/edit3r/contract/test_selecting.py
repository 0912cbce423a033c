"""What segmenters are asked with."""

import pytest

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Marks


@pytest.mark.parametrize(
    "marks",
    [
        {"positive": ((float("nan"), 0.5),)},
        {"negative": ((0.5, float("inf")),)},
        {"box": (0.1, 0.1, float("inf"), 0.2)},
    ],
)
def test_marks_that_are_no_numbers_are_refused(marks):
    with pytest.raises(InputError, match="numbers between 0 and 1"):
        Marks(**marks)
