"""PSNR and SSIM, by hand and against an independent calculation."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from edit3r.kit.compute.metrics import psnr, ssim


@pytest.fixture
def picture():
    return np.random.default_rng(0).random((32, 40, 3)).astype(np.float32)


def test_psnr_of_a_constant_error_is_its_logarithm():
    assert psnr(np.full((4, 4, 3), 0.6), np.full((4, 4, 3), 0.5)) == pytest.approx(20)


def test_psnr_of_equal_pictures_is_infinite(picture):
    assert math.isinf(psnr(picture, picture))


def test_psnr_clips_what_no_screen_shows():
    assert psnr(np.full((4, 4, 3), 7.0), np.full((4, 4, 3), 0.9)) == pytest.approx(20)


def test_covered_psnr_looks_at_covered_pixels_alone(picture):
    covered = np.zeros((32, 40), bool)
    covered[:10] = True
    wrong = picture.copy()
    wrong[10:] = 0
    wrong[:10] = np.clip(picture[:10] + 0.1, 0, 2)
    assert psnr(wrong, picture + 0.0, covered) >= 20 - 1e-6
    assert math.isnan(psnr(wrong, picture, np.zeros((32, 40), bool)))


def test_ssim_is_1_for_equal_pictures_and_falls_with_noise(picture):
    smooth = gaussian_filter(picture, (3, 3, 0))
    assert ssim(smooth, smooth) == pytest.approx(1)
    assert ssim(smooth + 0.1 * picture, smooth) < 0.9


def test_ssim_refuses_pictures_below_its_window():
    with pytest.raises(ValueError, match="at least 3 pixels a side"):
        ssim(np.zeros((2, 8, 3)), np.zeros((2, 8, 3)))


def test_psnr_of_a_tenth_off_everywhere_is_20_decibels(picture):
    assert psnr(0.5 * picture + 0.1, 0.5 * picture) == pytest.approx(20, abs=1e-4)


def test_ssim_agrees_with_an_independent_float64_calculation(picture):
    """Wang et al. (2004) with a uniform 7x7 window and unbiased moments, written out."""
    a = np.clip(
        picture + np.random.default_rng(1).normal(0, 0.1, picture.shape), 0, 1
    ).astype(np.float64)
    b = picture.astype(np.float64)
    windows = [
        np.lib.stride_tricks.sliding_window_view(x, (7, 7), axis=(0, 1)) for x in (a, b)
    ]
    mean_a, mean_b = (w.mean((-2, -1)) for w in windows)
    var_a, var_b = (w.var((-2, -1), ddof=1) for w in windows)
    product = (windows[0] - mean_a[..., None, None]) * (
        windows[1] - mean_b[..., None, None]
    )
    covariance = product.sum((-2, -1)) / 48
    c1, c2 = 0.01**2, 0.03**2
    values = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    values = values / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    assert ssim(a, picture) == pytest.approx(values.mean(), rel=1e-3)


def test_ssim_of_a_region_sees_what_lies_in_it_alone(picture):
    smooth = gaussian_filter(picture, (3, 3, 0))
    wrong = smooth.copy()
    wrong[:, 24:] = picture[:, 24:]
    left = np.zeros((32, 40), bool)
    left[:, :20] = True  # windows of 7 pixels reach to column 23
    assert ssim(wrong, smooth, left) == pytest.approx(1)
    assert ssim(wrong, smooth, ~left) < ssim(wrong, smooth) < 1
    assert math.isnan(ssim(wrong, smooth, 0 * left > 0))
