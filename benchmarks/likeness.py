"""How alike a rendering and its photo are, as the benchmarks that decide say it: four figures.

PSNR and SSIM ask each pixel; LPIPS (edit3r_measure/lpips.py, shift-tolerant) and the share of
detail say what a person sees. Needs `pip install "edit3r[stlpips]"`.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from edit3r_measure.lpips import lpips
from scipy.ndimage import gaussian_filter

from edit3r.kit.compute.metrics import Image, psnr, ssim

FINE = 1.0  # detail is what a Gaussian blur of so many pixels takes away


@dataclass(frozen=True)
class Likeness:
    """Of one image, or means over several."""

    psnr: float  # [dB]
    ssim: float
    lpips: float  # 0: alike
    detail: float  # its energy as a share of the photo's

    def __str__(self) -> str:
        return f"{self.psnr:.2f}, {self.ssim:.3f}, {self.lpips:.3f}, {self.detail:.2f}"


TITLE = "dB, SSIM, LPIPS, detail"


def likeness(image: Image, photo: Image) -> Likeness:
    """Compare an image with its photo, both sRGB in [0, 1]."""
    return Likeness(
        psnr(image, photo),
        ssim(image, photo),
        lpips(image, photo),
        _energy(image) / max(_energy(photo), 1e-12),
    )


def mean(several: Sequence[Likeness]) -> Likeness:
    return Likeness(*(float(v) for v in np.mean([astuple(o) for o in several], axis=0)))


def _energy(image: Image) -> float:
    grey = image.mean(2)
    return float(np.square(grey - gaussian_filter(grey, FINE)).mean())
