"""LPIPS by the weights of `stlpips-pytorch`."""

import importlib.util

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from edit3r.contract.errors import MissingDependencyError
from edit3r.kit.compute import lpips as module
from edit3r.kit.compute.lpips import lpips_distance, lpips_distances, lpips_weights

RECORDED = 0.0698, 0.0056  # of two pictures, and of one that is shifted by a pixel
CHANNELS, KERNELS = (3, 4, 6, 8, 6, 6), (11, 5, 3, 3, 3)


def picture(seed=0, size=(48, 65)):
    noise = np.random.default_rng(seed).random((*size, 3))
    return gaussian_filter(noise, (1, 1, 0)).astype(np.float32)


@pytest.fixture
def random_weights(monkeypatch):
    """Of the network's form, with few channels."""
    draw, weights = torch.Generator().manual_seed(0), {}
    for layer, name in enumerate(module.CONVOLUTIONS):
        sizes = CHANNELS[layer + 1], CHANNELS[layer], *(KERNELS[layer],) * 2
        weights[f"net.{name}.weight"] = torch.randn(sizes, generator=draw)
        weights[f"net.{name}.bias"] = torch.randn(sizes[0], generator=draw)
        weights[f"lin{layer}.model.1.weight"] = torch.ones(1, sizes[0], 1, 1)
    monkeypatch.setattr(module, "_weights", lambda device: weights)


def test_what_is_blurred_more_is_further_away_and_a_picture_is_like_itself(
    random_weights,
):
    photo = picture()
    blurred, more = (gaussian_filter(photo, (sigma, sigma, 0)) for sigma in (1, 2))
    same, near, far = (lpips_distance(own, photo) for own in (photo, blurred, more))
    # features of length 1 without a negative value are 2 apart at most, squared
    assert 0 == same < near < far < 2 * len(module.CONVOLUTIONS)


def test_a_step_against_the_gradient_brings_an_image_nearer_even_from_black(
    random_weights,
):
    """Where all features are zero the root has no slope: that must not become NaN."""
    image = torch.zeros(2, 3, 48, 48, requires_grad=True)
    photos = torch.from_numpy(np.stack([picture(seed, (48, 48)) for seed in (0, 1)]))
    photos = photos.permute(0, 3, 1, 2).float()
    for start in (image, (photos * 0.8).detach().requires_grad_()):
        before = lpips_distances(start, photos)
        (slope,) = torch.autograd.grad(before.sum(), start)
        assert before.shape == (2,) and slope.isfinite().all()
    assert (lpips_distances(start - 0.01 * slope.sign(), photos) < before).all()


@pytest.mark.skipif(
    importlib.util.find_spec(module.PACKAGE) is None,
    reason="needs the weights of stlpips-pytorch",
)
def test_distances_are_those_of_the_package_s_own_code():
    """0.0.2, its code run once beside stand-ins for torchvision and IPython."""
    shifted = np.roll(picture(), 1, axis=1)
    assert lpips_distance(picture(1), picture()) == pytest.approx(RECORDED[0], abs=2e-4)
    assert lpips_distance(shifted, picture()) == pytest.approx(RECORDED[1], abs=2e-4)
    assert "stlpips-pytorch 0." in lpips_weights()


def test_a_missing_package_is_named_and_said_beforehand(monkeypatch):
    monkeypatch.setattr(module, "PACKAGE", "no_such_package")
    module._weights.cache_clear()
    assert lpips_weights() == ""
    with pytest.raises(MissingDependencyError, match=r"edit3r\[stlpips\]"):
        lpips_distance(picture(), picture())
