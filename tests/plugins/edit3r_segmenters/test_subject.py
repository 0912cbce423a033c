"""What stands out is surely the subject where it ends clearly, is large and lies in the middle."""

import numpy as np
import pytest
from edit3r_segmenters.subject import clearness

from edit3r.contract.interfaces import SURE

ROWS, COLUMNS = np.mgrid[:48, :64]
DISC = 16 - np.hypot(ROWS - 24, COLUMNS - 32)  # pixels within its rim


@pytest.mark.parametrize(
    ("salience", "sure"),
    [
        (DISC > 0, True),
        (np.clip(0.5 + DISC / 24, 0, 1), False),  # no clear end
        ((DISC > 0) & (abs(COLUMNS - 32) > 6), False),  # two pieces
        (DISC > 10, False),  # small
        (np.hypot(ROWS - 24, COLUMNS - 52) < 18, False),  # aside
        (DISC > 99, False),  # nothing
    ],
    ids=["clear", "blurred", "pieces", "small", "aside", "nothing"],
)
def test_what_is_no_clear_subject_is_not_sure(salience, sure):
    assert (clearness(salience.astype(float)) >= SURE) == sure
