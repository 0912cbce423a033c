import cv2
import numpy as np
import pytest

from edit3r.kit.compute.layers import weighted_smooth


@pytest.fixture
def threads():
    before = cv2.getNumThreads()
    yield cv2.setNumThreads
    cv2.setNumThreads(before)


def test_smoothing_gives_the_same_bits_for_any_number_of_threads(threads):
    draw = np.random.default_rng(0)
    guide = draw.integers(0, 255, (40, 61, 3), np.uint8)
    values, weights = draw.random((2, 40, 61), np.float32)
    answers = set()
    for count in (1, 2, 3, 7):
        threads(count)
        answers.add(weighted_smooth(values, weights, guide, 2000.0, 6.0).tobytes())
        assert cv2.getNumThreads() == count
    assert len(answers) == 1


def test_a_value_spreads_over_flat_colour_and_stops_at_an_edge():
    guide = np.zeros((20, 40, 3), np.uint8)
    guide[:, 20:] = 255
    values = np.zeros((20, 40), np.float32)
    values[10, 5], values[10, 35] = 1, 3
    weights = (values > 0).astype(np.float32) + np.float32(1e-6)
    smooth = weighted_smooth(values, weights, guide, 2000.0, 6.0)
    assert np.allclose(smooth[:, :20], 1, atol=0.01)
    assert np.allclose(smooth[:, 20:], 3, atol=0.03)
