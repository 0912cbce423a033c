"""The loss of a fit against an independent implementation and against its definition."""

import pytest
import torch
from edit3r_optimisers.photometric import photometric_loss, structural_similarity
from skimage.metrics import structural_similarity as reference


@pytest.fixture(scope="module")
def pair():
    generator = torch.Generator().manual_seed(0)
    a = torch.rand(3, 24, 30, generator=generator, dtype=torch.float64)
    return a, (a + 0.2 * torch.randn(a.shape, generator=generator, dtype=torch.float64)).clamp(0, 1)


def test_ssim_agrees_with_scikit_image_on_whole_windows(pair):
    a, b = (picture.permute(1, 2, 0).numpy() for picture in pair)
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "full": True}
    maps = reference(a, b, channel_axis=2, data_range=1.0, **options)[1]
    inside = maps[5:-5, 5:-5].mean()
    assert float(structural_similarity(*pair)) == pytest.approx(inside, abs=1e-9)


def test_a_picture_equals_itself_and_the_loss_is_zero(pair):
    assert float(structural_similarity(pair[0], pair[0])) == pytest.approx(1, abs=1e-12)
    assert float(photometric_loss(pair[0], pair[0], 0.2)) == pytest.approx(0, abs=1e-12)


def test_weights_of_the_two_terms_are_those_of_the_paper(pair):
    l1, dssim = (pair[0] - pair[1]).abs().mean(), (1 - structural_similarity(*pair)) / 2
    assert torch.allclose(photometric_loss(*pair, 0.2), 0.8 * l1 + 0.2 * dssim)
    assert torch.equal(photometric_loss(*pair, 0), l1)


def test_gradient_agrees_with_finite_differences(pair):
    a, b = pair[0][:1, :12, :13].clone().requires_grad_(), pair[1][:1, :12, :13]
    assert torch.autograd.gradcheck(lambda picture: photometric_loss(picture, b, 0.2), a, atol=1e-7)


def test_a_picture_smaller_than_a_window_has_a_loss():
    assert torch.isfinite(photometric_loss(torch.rand(3, 4, 2), torch.rand(3, 4, 2), 0.2))
