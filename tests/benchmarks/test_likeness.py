"""The four figures of the benchmarks that decide."""

from importlib.machinery import SourceFileLoader
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

FILE = Path(__file__).parents[2] / "benchmarks" / "likeness.py"
likeness = SourceFileLoader("likeness", str(FILE)).load_module()


@pytest.fixture(autouse=True)
def without_weights(monkeypatch):
    """LPIPS has tests of its own, and its weights may be missing."""
    distance = lambda image, photo: float(np.abs(image - photo).mean())  # noqa: E731
    monkeypatch.setattr(likeness, "lpips_distance", distance)


def picture(seed=0, size=(48, 65)):
    noise = np.random.default_rng(seed).random((*size, 3))
    return gaussian_filter(noise, (1, 1, 0)).astype(np.float32)


def test_an_image_is_like_itself():
    found = likeness.likeness(picture(), picture())
    assert found.lpips == 0 and found.ssim == pytest.approx(1)
    assert found.detail == pytest.approx(1) and found.psnr > 100


def test_what_is_blurred_has_less_detail():
    photo, blurred = picture(), gaussian_filter(picture(), (1, 1, 0))
    more = gaussian_filter(picture(), (2, 2, 0))
    first, second = likeness.likeness(blurred, photo), likeness.likeness(more, photo)
    assert 0 < second.detail < first.detail < 1


def test_means_are_by_figure():
    one, other = (likeness.likeness(picture(seed), picture()) for seed in (1, 2))
    between = likeness.mean([one, other])
    assert between.lpips == pytest.approx((one.lpips + other.lpips) / 2)
    assert str(between).count(",") == likeness.TITLE.count(",")


def test_disagreement_is_that_of_the_changes_not_of_the_photos():
    generator = torch.Generator().manual_seed(0)
    grain = torch.rand(1, 3, 40, 46, generator=generator)
    wide = torch.nn.functional.interpolate(grain, scale_factor=4, mode="bicubic")
    wide = 0.3 + 0.4 * wide[0].clamp(0, 1)
    photos = torch.stack((wide[..., :160], wide[..., 24:]))
    # another exposure, not another edit
    darker = torch.stack((photos[0], 0.5 * photos[1]))
    found = likeness.disagreement(darker, darker + 0.1)
    assert found == pytest.approx(0, abs=1e-3)
    apart = torch.stack((photos[0] + 0.1, photos[1] - 0.1))
    assert likeness.disagreement(photos, apart) == pytest.approx(0.2, abs=5e-3)


def test_disagreement_of_photos_without_common_spots_is_not_measured():
    flat = torch.full((2, 3, 64, 64), 0.5)
    assert likeness.disagreement(flat, flat) is None
