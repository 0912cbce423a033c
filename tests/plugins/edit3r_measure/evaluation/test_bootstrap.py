"""Intervals over scenes."""

import numpy as np
import pytest
from edit3r_measure.evaluation.bootstrap import bootstrap_mean


def test_the_mean_is_over_scenes_not_over_edits():
    interval = bootstrap_mean({"a": [1.0, 1.0, 1.0, 1.0], "b": [3.0]})
    assert interval.mean == 2 and (interval.low, interval.high) == (1, 3) and interval.scenes == 2


def test_unknown_values_are_left_out_and_none_means_nothing_known():
    assert bootstrap_mean({"a": [float("nan"), 2.0], "b": [float("nan")]}).mean == 2
    assert bootstrap_mean({"a": [float("nan")]}) is None


def test_the_interval_has_the_width_of_the_standard_error():
    values = np.random.default_rng(0).normal(size=100)
    interval = bootstrap_mean({str(i): [v] for i, v in enumerate(values)})
    expected = 2 * 1.96 * values.std() / 10
    assert interval.high - interval.low == pytest.approx(expected, rel=0.1)


def test_the_same_values_give_the_same_interval():
    values = {"a": [0.1], "b": [0.7], "c": [0.4]}
    assert bootstrap_mean(values) == bootstrap_mean(values)
