"""Pictures and masks in SAM2's square."""

import torch
from edit3r_segmenters import preprocess


def test_grey_becomes_imagenet_normalised_whatever_the_shape():
    pixels = preprocess.pixel_values(torch.full((2, 3, 30, 50), 0.5), 64)
    assert pixels.shape == (2, 3, 64, 64)
    assert torch.allclose(pixels[0, :, 0, 0], torch.tensor([0.015 / 0.229, 0.044 / 0.224, 0.094 / 0.225]), atol=1e-5)


def test_masks_are_cut_at_a_half():
    soft = torch.tensor([[[0.2, 0.6], [0.5, 0.4]]])
    assert preprocess.binary_masks(soft, 2).tolist() == [[[0, 1], [1, 0]]]


def test_enlarging_keeps_the_order_of_masks_and_constants():
    logits = torch.arange(6.0).view(2, 3, 1, 1).expand(2, 3, 4, 4)
    large = preprocess.enlarge(logits, (7, 9))
    assert large.shape == (2, 3, 7, 9)
    assert torch.equal(large[..., 0, 0], torch.arange(6.0).view(2, 3))
