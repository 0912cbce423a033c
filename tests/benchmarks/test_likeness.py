"""The four figures of the benchmarks that decide."""

import importlib.util
from importlib.machinery import SourceFileLoader
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

FILE = Path(__file__).parents[2] / "benchmarks" / "likeness.py"
likeness = SourceFileLoader("likeness", str(FILE)).load_module()
RECORDED = 0.0698, 0.0056  # of two pictures, and of one that is shifted by a pixel
CHANNELS, KERNELS = (3, 4, 6, 8, 6, 6), (11, 5, 3, 3, 3)


@pytest.fixture
def small(monkeypatch):
    """Random weights of the network's form, with few channels."""
    draw, weights = torch.Generator().manual_seed(0), {}
    for layer, name in enumerate(likeness.CONVOLUTIONS):
        sizes = CHANNELS[layer + 1], CHANNELS[layer], *(KERNELS[layer],) * 2
        weights[f"net.{name}.weight"] = torch.randn(sizes, generator=draw)
        weights[f"net.{name}.bias"] = torch.randn(sizes[0], generator=draw)
        weights[f"lin{layer}.model.1.weight"] = torch.ones(1, sizes[0], 1, 1)
    monkeypatch.setattr(likeness, "_weights", lambda: weights)


def picture(seed=0, size=(48, 65)):
    noise = np.random.default_rng(seed).random((*size, 3))
    return gaussian_filter(noise, (1, 1, 0)).astype(np.float32)


def test_an_image_is_like_itself(small):
    found = likeness.likeness(picture(), picture())
    assert found.lpips == 0 and found.ssim == pytest.approx(1)
    assert found.detail == pytest.approx(1) and found.psnr > 100


def test_what_is_blurred_has_less_detail_and_is_further_away(small):
    photo, blurred = picture(), gaussian_filter(picture(), (1, 1, 0))
    more = gaussian_filter(picture(), (2, 2, 0))
    first, second = likeness.likeness(blurred, photo), likeness.likeness(more, photo)
    assert 0 < second.detail < first.detail < 1
    assert 0 < first.lpips < second.lpips


def test_means_are_by_figure(small):
    one, other = (likeness.likeness(picture(seed), picture()) for seed in (1, 2))
    between = likeness.mean([one, other])
    assert between.lpips == pytest.approx((one.lpips + other.lpips) / 2)
    assert str(between).count(",") == likeness.TITLE.count(",")


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(likeness, "PACKAGE", "no_such_package")
    likeness._weights.cache_clear()
    with pytest.raises(SystemExit, match=r"edit3r\[stlpips\]"):
        likeness.lpips(picture(), picture())


@pytest.mark.skipif(
    importlib.util.find_spec("stlpips_pytorch") is None,
    reason="needs the weights of stlpips-pytorch",
)
def test_distances_are_those_of_the_package_s_own_code():
    """0.0.2, its code run once beside stand-ins for torchvision and IPython."""
    likeness._weights.cache_clear()
    shifted = np.roll(picture(), 1, axis=1)
    assert likeness.lpips(picture(1), picture()) == pytest.approx(RECORDED[0], abs=2e-4)
    assert likeness.lpips(shifted, picture()) == pytest.approx(RECORDED[1], abs=2e-4)
