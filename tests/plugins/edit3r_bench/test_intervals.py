"""Means over scenes and how sure they are."""

import math

import numpy as np
import pytest
from edit3r_bench.intervals import MIN_SCENES, holm, mean_over_scenes


def test_the_mean_is_over_scenes_not_over_edits():
    interval = mean_over_scenes({"a": [1.0, 1.0, 1.0, 1.0], "b": [3.0]})
    assert (interval.mean, interval.scenes) == (2, 2)


def test_unknown_values_are_left_out_and_none_means_nothing_known():
    assert mean_over_scenes({"a": [math.nan, 2.0], "b": [math.nan]}).mean == 2
    assert mean_over_scenes({"a": [math.nan]}) is None


def test_few_scenes_have_no_interval():
    few = {str(scene): [float(scene)] for scene in range(MIN_SCENES - 1)}
    assert mean_over_scenes(few).low is None


@pytest.mark.slow
@pytest.mark.parametrize("scenes", [5, 20])
def test_intervals_hold_the_true_mean_in_93_to_97_percent_of_samples(scenes):
    rng = np.random.default_rng(scenes)
    hits = 0
    for _ in range(500):
        values = enumerate(rng.normal(3.0, 2.0, scenes))
        interval = mean_over_scenes({str(scene): [own] for scene, own in values})
        hits += interval.low <= 3.0 <= interval.high
    assert 0.93 <= hits / 500 <= 0.97


def test_values_that_agree_have_a_p_value_that_says_so():
    same = {str(scene): [0.0] for scene in range(6)}
    assert mean_over_scenes(same).p_value == 1
    other = {str(scene): [1.0] for scene in range(6)}
    assert mean_over_scenes(other).p_value == 0


def test_holm_multiplies_the_smallest_by_the_number_and_keeps_the_order():
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
