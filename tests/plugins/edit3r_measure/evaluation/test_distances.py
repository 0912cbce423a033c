"""Fréchet and kernel distances against hand-made cases and against independent float64 implementations."""

import numpy as np
import pytest
from edit3r_measure.evaluation.frechet import frechet_distance
from edit3r_measure.evaluation.kernel_distance import kernel_distance
from scipy.linalg import sqrtm


def textbook_frechet(a, b):
    """As FID is usually written: full covariances and a matrix square root."""
    root = sqrtm(np.cov(a, rowvar=False) @ np.cov(b, rowvar=False))
    trace = np.trace(np.cov(a, rowvar=False) + np.cov(b, rowvar=False) - 2 * np.real(root))
    return ((a.mean(0) - b.mean(0)) ** 2).sum() + trace


def loop_kernel(a, b):
    """KID's unbiased estimator term by term."""

    def kernel(x, y):
        return (float(x @ y) / len(x) + 1) ** 3

    within_a = np.mean([kernel(x, y) for i, x in enumerate(a) for j, y in enumerate(a) if i != j])
    within_b = np.mean([kernel(x, y) for i, x in enumerate(b) for j, y in enumerate(b) if i != j])
    return within_a + within_b - 2 * np.mean([kernel(x, y) for x in a for y in b])


@pytest.fixture
def features():
    rng = np.random.default_rng(0)
    mix = rng.normal(size=(12, 12))
    return rng.normal(size=(90, 12)) @ mix, 0.5 + rng.normal(size=(70, 12)) @ mix * 1.3


def test_frechet_distance_of_two_hand_made_lines():
    # Means 1 and 4, unbiased variances 2 and 8: (1 - 4)^2 + 2 + 8 - 2 sqrt(2 * 8) = 11
    assert frechet_distance(np.array([[0.0], [2.0]]), np.array([[2.0], [6.0]])) == pytest.approx(11.0)


def test_kernel_distance_of_hand_made_points():
    # One feature: within {0, 1}: (0 + 1)^3 = 1; within {1, 2}: (2 + 1)^3 = 27; across: (1 + 1 + 8 + 27) / 4
    value = kernel_distance(np.array([[0.0], [1.0]]), np.array([[1.0], [2.0]]))
    assert value == pytest.approx(1 + 27 - 2 * (1 + 1 + 8 + 27) / 4)


def test_frechet_distance_agrees_with_the_matrix_square_root(features):
    assert frechet_distance(*features) == pytest.approx(textbook_frechet(*features), rel=1e-6)


def test_kernel_distance_agrees_with_the_double_loop(features):
    assert kernel_distance(*features) == pytest.approx(loop_kernel(*features), rel=1e-9)


def test_frechet_distance_is_exact_with_fewer_pictures_than_features():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(9, 40)), 0.3 + rng.normal(size=(7, 40))
    assert frechet_distance(a, b) == pytest.approx(textbook_frechet(a, b), rel=1e-3)


def test_equal_sets_are_at_distance_zero_and_order_does_not_matter(features):
    a, b = features
    assert frechet_distance(a, a[::-1]) == pytest.approx(0, abs=1e-9 * float(np.square(a).sum()))
    assert frechet_distance(a, b) == pytest.approx(frechet_distance(b[::-1], a))
    assert kernel_distance(a, b) == pytest.approx(kernel_distance(b[::-1], a))


def test_kernel_distance_of_one_distribution_is_about_zero():
    rng = np.random.default_rng(2)
    values = [kernel_distance(*rng.normal(size=(2, 30, 16))) for _ in range(40)]
    assert abs(np.mean(values)) < 3 * np.std(values) / np.sqrt(len(values))


@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
def test_a_single_picture_is_no_distribution(distance):
    with pytest.raises(ValueError, match="at least 2"):
        distance(np.zeros((1, 3)), np.zeros((4, 3)))
