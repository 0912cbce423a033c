"""Measures of change, on pictures small enough to reckon by hand."""

import numpy as np
import pytest
from edit3r_measure.evaluation.changes import change_outside, edit_strength, edit_uptake


@pytest.fixture
def photos():
    return np.random.default_rng(0).uniform(0.2, 0.6, (2, 40, 50, 3))


@pytest.fixture
def masks():
    masks = np.zeros((2, 40, 50))
    masks[:, :, :25] = 1
    return masks


def test_strength_of_a_uniform_change_is_that_change(photos):
    assert edit_strength(photos + 0.25, photos) == pytest.approx(0.25)


def test_nothing_done_has_no_strength_and_no_uptake(photos, masks):
    assert edit_strength(photos, photos, masks) == 0
    assert edit_uptake(photos, photos, photos + 0.1) == 0
    assert edit_uptake(photos + 0.1, photos, photos) == 0  # nothing was wished


def test_strength_ignores_fine_noise_and_counts_the_mask_alone(photos, masks):
    noise = np.random.default_rng(1).choice([-0.2, 0.2], photos.shape)
    assert edit_strength(photos + noise, photos) < 0.2 * np.abs(noise).mean() * 2.5
    far = photos.copy()
    far[:, :, 35:] += 0.3  # well away from the mask
    assert edit_strength(far, photos, masks) < 1e-6
    assert change_outside(far, photos, masks) == pytest.approx(0.3 * 15 / 25, rel=1e-6)


def test_uptake_is_the_share_of_the_wish(photos, masks):
    wish = photos + masks[..., None] * np.array([0.2, -0.1, 0.0])
    assert edit_uptake(wish, photos, wish, masks) == pytest.approx(1)
    assert edit_uptake(photos + 0.5 * (wish - photos), photos, wish, masks) == pytest.approx(0.5)
    assert edit_uptake(photos - (wish - photos), photos, wish, masks) == pytest.approx(-1)
    assert edit_uptake(photos + np.array([0, 0, 0.3]), photos, wish, masks) == pytest.approx(0)


def test_masks_that_leave_nothing_measure_nothing(photos):
    everything = np.ones(photos.shape[:3])
    assert np.isnan(change_outside(photos, photos, everything))
    assert np.isnan(edit_strength(photos, photos, 0 * everything))
