import itertools

import numpy as np
import pytest
from edit3r_training.photo_dataset import choose_by_angle, choose_by_gap, growing_gap
from edit3r_training.procedural_scenes import look_at


def _ring(count: int) -> np.ndarray:
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack(
        [look_at(np.array([np.sin(a), 0.1, np.cos(a)]), np.zeros(3)) for a in turns]
    )


@pytest.mark.parametrize("seed", range(5))
def test_gap_is_within_its_range_and_targets_lie_between(seed):
    choice = choose_by_gap(
        np.random.default_rng(seed), 60, context=3, targets=4, gap=(10, 20)
    )
    context, targets = choice[:3], choice[3:]
    assert 10 <= context[-1] - context[0] <= 20
    assert len(targets) == 4
    assert all(context[0] <= target <= context[-1] for target in targets)
    assert context == sorted(context)


def test_the_gap_grows_evenly_from_its_start_and_then_stays():
    grown = [growing_gap((25, 25), (45, 90), way) for way in (0, 0.5, 1, 1.7)]
    assert grown == [(25, 25), (35, 58), (45, 90), (45, 90)]
    assert growing_gap(None, (45, 90), 0) == (45, 90)


def test_a_short_sequence_gets_the_widest_gap_it_has_and_a_single_frame_none():
    rng = np.random.default_rng(0)
    assert choose_by_gap(rng, 4, context=2, targets=1, gap=(10, 20))[:2] == [0, 3]
    assert choose_by_gap(rng, 1, context=2, targets=1, gap=(1, 2)) is None
    # five different frames do not lie two apart
    assert choose_by_gap(rng, 10, context=5, targets=1, gap=(1, 2)) is None


@pytest.mark.parametrize("seed", range(5))
def test_neighbouring_context_views_are_the_asked_for_angle_apart(seed):
    c2w = _ring(36)
    choice = choose_by_angle(
        np.random.default_rng(seed), c2w, context=3, targets=2, angles=(8, 25)
    )
    for a, b in itertools.pairwise(choice[:3]):
        angle = np.degrees(np.arccos(np.clip(c2w[a][:3, 2] @ c2w[b][:3, 2], -1, 1)))
        assert 8 <= angle <= 25
    assert len(choice) == 5 and not set(choice[:3]) & set(choice[3:])


def test_views_too_far_apart_are_not_forced_together():
    assert (
        choose_by_angle(
            np.random.default_rng(0), _ring(4), context=2, targets=1, angles=(5, 30)
        )
        is None
    )
