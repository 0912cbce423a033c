"""How close two pictures are, and how much a blurred copy of an input photo would already have given.

Pictures are NumPy arrays `[height, width, 3]`, sRGB in [0, 1].
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

__all__ = ["BLURS", "BlurredCopy", "best_blurred_copy", "covered_psnr", "psnr", "ssim", "within_share"]

BLURS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Standard deviations tried for the best-blurred copy [pixels]."""

_SMALLEST_SSIM_WINDOW = 3
_SSIM_WINDOW = 7


@dataclass(frozen=True)
class BlurredCopy:
    """The best that blurring one photo can do as a guess of another."""

    psnr: float  # [dB]
    ssim: float  # of the same blurred picture
    sigma: float  # [pixels]


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Peak signal-to-noise ratio [dB] of `image` clipped to [0, 1]; infinite for equal pictures."""
    with np.errstate(divide="ignore"):
        return float(peak_signal_noise_ratio(target, np.clip(image, 0, 1), data_range=1.0))


def covered_psnr(image: np.ndarray, target: np.ndarray, covered: np.ndarray) -> float:
    """PSNR [dB] over the pixels `covered` `[height, width]` bool; NaN when there are none."""
    return psnr(image[covered], target[covered]) if covered.any() else float("nan")


def ssim(image: np.ndarray, target: np.ndarray) -> float:
    """Mean structural similarity (Wang et al. 2004, 7x7 window, mean over channels); at least 3x3 pixels."""
    window = min(_SSIM_WINDOW, *target.shape[:2])
    if window < _SMALLEST_SSIM_WINDOW:
        raise ValueError(f"ssim: expected pictures of at least 3x3 pixels, got {target.shape[:2]}")
    window -= 1 - window % 2
    clipped = np.clip(image, 0, 1).astype(target.dtype)
    return float(structural_similarity(clipped, target, win_size=window, channel_axis=-1, data_range=1.0))


def best_blurred_copy(
    photos: Iterable[np.ndarray], target: np.ndarray, covered: np.ndarray | None = None
) -> BlurredCopy:
    """The highest PSNR that any of `photos` reaches under any Gaussian blur: what knowing no geometry gives.

    A prediction that is not clearly above this has learnt to blur, not where things are. The PSNR counts the pixels
    `covered` `[height, width]` bool only, if given; the SSIM is always that of the whole picture.
    """
    counted = np.ones(target.shape[:2], bool) if covered is None else covered
    copies = ((gaussian_filter(photo, (sigma, sigma, 0)), sigma) for photo in photos for sigma in BLURS)
    scored = ((covered_psnr(copy, target, counted), copy, sigma) for copy, sigma in copies)
    score, copy, sigma = max(scored, key=lambda item: item[0])
    return BlurredCopy(score, ssim(copy, target), sigma)


def within_share(depth: np.ndarray, truth: np.ndarray, tolerance: float = 0.1) -> float:
    """Share of the pixels of known `truth` (> 0) whose `depth` is within `tolerance` of it after one common scale.

    The scale is the median ratio; a pixel without a depth (0) counts as wrong.
    """
    known = truth > 0
    measured = known & (depth > 0)
    if not measured.any():
        return 0.0
    scale = np.median(truth[measured] / depth[measured])
    right = measured & (np.abs(depth * scale / np.where(known, truth, 1) - 1) <= tolerance)
    return float(right.sum() / known.sum())
