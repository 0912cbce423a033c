"""LPIPS by the weights of `stlpips-pytorch`."""

import importlib.util

import numpy as np
import pytest
import torch
from edit3r_measure import lpips as module
from edit3r_measure.lpips import lpips, lpips_weights
from scipy.ndimage import gaussian_filter

from edit3r.contract.errors import MissingDependencyError

RECORDED = 0.0698, 0.0056  # of two pictures, and of one that is shifted by a pixel
CHANNELS, KERNELS = (3, 4, 6, 8, 6, 6), (11, 5, 3, 3, 3)


def picture(seed=0, size=(48, 65)):
    noise = np.random.default_rng(seed).random((*size, 3))
    return gaussian_filter(noise, (1, 1, 0)).astype(np.float32)


def test_what_is_blurred_more_is_further_away_and_a_picture_is_like_itself(monkeypatch):
    """Random weights of the network's form, with few channels."""
    draw, weights = torch.Generator().manual_seed(0), {}
    for layer, name in enumerate(module.CONVOLUTIONS):
        sizes = CHANNELS[layer + 1], CHANNELS[layer], *(KERNELS[layer],) * 2
        weights[f"net.{name}.weight"] = torch.randn(sizes, generator=draw)
        weights[f"net.{name}.bias"] = torch.randn(sizes[0], generator=draw)
        weights[f"lin{layer}.model.1.weight"] = torch.ones(1, sizes[0], 1, 1)
    monkeypatch.setattr(module, "_weights", lambda: weights)
    photo = picture()
    blurred, more = (gaussian_filter(photo, (sigma, sigma, 0)) for sigma in (1, 2))
    assert 0 == lpips(photo, photo) < lpips(blurred, photo) < lpips(more, photo)


@pytest.mark.skipif(
    importlib.util.find_spec(module.PACKAGE) is None,
    reason="needs the weights of stlpips-pytorch",
)
def test_distances_are_those_of_the_package_s_own_code():
    """0.0.2, its code run once beside stand-ins for torchvision and IPython."""
    shifted = np.roll(picture(), 1, axis=1)
    assert lpips(picture(1), picture()) == pytest.approx(RECORDED[0], abs=2e-4)
    assert lpips(shifted, picture()) == pytest.approx(RECORDED[1], abs=2e-4)
    assert "stlpips-pytorch 0." in lpips_weights()


def test_a_missing_package_is_named_and_said_beforehand(monkeypatch):
    monkeypatch.setattr(module, "PACKAGE", "no_such_package")
    module._weights.cache_clear()
    assert lpips_weights() == ""
    with pytest.raises(MissingDependencyError, match=r"edit3r\[stlpips\]"):
        lpips(picture(), picture())
