"""What passed while the photos were taken leaves the scene, unless the user selected it."""

import pytest
import torch

from edit3r.running.steps.reconstruct import _beside

PASSED = torch.zeros(1, 3, 4, 6, dtype=torch.bool)
PASSED[:, 1, :, :4] = True
LEFT = torch.zeros(1, 3, 4, 6)
LEFT[..., :2] = 0.5


@pytest.mark.parametrize(
    "masks, columns",
    [
        (None, [0, 1, 2, 3]),
        (torch.ones(1, 3, 4, 6), [0, 1, 2, 3]),  # nothing was selected
        (LEFT, [2, 3]),
        (PASSED.float(), []),
    ],
)
def test_what_the_user_selected_is_no_passing_thing(masks, columns):
    left = _beside(PASSED, masks)
    if not columns:
        assert left is None
        return
    assert left[0].any(1)[1].nonzero()[:, 0].tolist() == columns
    assert not left[:, [0, 2]].any()


def test_where_nothing_passed_nothing_is_left_out():
    assert _beside(None, LEFT) is _beside(PASSED & False, None) is None
