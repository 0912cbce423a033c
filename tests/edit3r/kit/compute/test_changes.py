import numpy as np
import pytest
import torch

from edit3r.kit.compute.changes import change_error, change_uptake, mean_change

WISHED = np.array([[0.2, 0.4], [0.1, 0.3]])
EVERYWHERE = np.ones((2, 2))


@pytest.mark.parametrize("share", [0, 0.5, 1, -1])
def test_uptake_and_error_are_those_of_the_share_that_is_shown(share):
    assert change_uptake(share * WISHED, WISHED, EVERYWHERE) == pytest.approx(share)
    assert change_error(share * WISHED, WISHED, EVERYWHERE) == pytest.approx(1 - share)


def test_what_has_no_weight_does_not_count():
    first = np.array([[1.0], [0.0]])
    shown = WISHED * first + (1 - first)
    assert change_uptake(shown, WISHED, first) == pytest.approx(1)
    assert change_error(shown, WISHED, first) == pytest.approx(0)
    assert mean_change(shown, np.broadcast_to(first, (2, 2))) == pytest.approx(0.3)


def test_a_change_that_nobody_wished_is_no_uptake():
    nothing = np.zeros((2, 2))
    assert (
        change_uptake(WISHED, nothing, EVERYWHERE)
        == change_error(WISHED, nothing, EVERYWHERE)
        == 0
    )
    assert mean_change(WISHED, nothing) == 0


def test_tensors_give_what_arrays_give():
    shown, wished, weight = (
        torch.from_numpy(values) for values in (WISHED.T.copy(), WISHED, EVERYWHERE)
    )
    assert change_uptake(shown, wished, weight) == pytest.approx(
        change_uptake(WISHED.T, WISHED, EVERYWHERE)
    )
