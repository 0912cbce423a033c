import pytest
import torch
from edit3r_recolor.parameters import RecolorParameters, RecolorRanges, sample_parameters
from edit3r_recolor.transform import recolor, to_greyscale
from hypothesis import given, settings
from hypothesis import strategies as st

STRONG = RecolorRanges(brightness=1, contrast=1, saturation=1, gamma=4, lighting=2)


def picture(*shape: int, dtype=torch.float32) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1), dtype=dtype)


def test_default_parameters_change_nothing():
    image = picture(3, 5, 7, dtype=torch.float64)
    assert torch.allclose(recolor(image, RecolorParameters()), image, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_the_result_is_finite_and_in_range_for_any_parameters(seed):
    image = picture(2, 3, 4, 6)
    image[0, :, 0], image[0, :, 1] = 0, 1
    result = recolor(image, sample_parameters(torch.Generator().manual_seed(seed), STRONG))
    assert result.shape == image.shape and torch.isfinite(result).all()
    assert result.min() >= 0 and result.max() <= 1


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_a_colour_maps_to_the_same_colour_in_every_picture(seed):
    """What makes one Theta the same edit in all views: neighbours and picture size have no say."""
    parameters = sample_parameters(torch.Generator().manual_seed(seed), STRONG)
    image = picture(3, 6, 8)
    shuffled = image.flatten(1)[:, torch.randperm(48, generator=torch.Generator().manual_seed(seed))]
    alone = recolor(image[:, 2:3, 5:6], parameters)
    assert torch.allclose(recolor(image, parameters)[:, 2:3, 5:6], alone, atol=1e-6)
    index = (shuffled - image[:, 2, 5:6]).abs().sum(0).argmin()
    assert torch.allclose(recolor(shuffled[:, None], parameters)[:, 0, index], alone[:, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    "change, before, after",
    [
        ({"brightness": 0.5}, (0.2, 0.4, 0.8), (0.1, 0.2, 0.4)),
        ({"contrast": 0.5}, (0.2, 0.5, 1.0), (0.35, 0.5, 0.75)),
        ({"gamma": 2.0}, (0.5, 1.0, 0.1), (0.25, 1.0, 0.01)),
        ({"lighting": (0.1, 0.0, -0.3)}, (0.5, 0.5, 0.2), (0.6, 0.5, 0.0)),
        ({"permutation": (2, 0, 1)}, (0.1, 0.2, 0.3), (0.3, 0.1, 0.2)),
        ({"hue": 1 / 3}, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ({"greyscale": True}, (1.0, 0.0, 0.0), (0.299, 0.299, 0.299)),
        ({"saturation": 0.0}, (1.0, 0.0, 0.0), (0.299, 0.299, 0.299)),
    ],
)
def test_each_part_alone(change, before, after):
    image = torch.tensor(before, dtype=torch.float64)[:, None, None]
    result = recolor(image, RecolorParameters(**change))
    assert torch.allclose(result[:, 0, 0], torch.tensor(after, dtype=torch.float64), atol=2e-3)


def test_the_order_of_the_jitters_counts():
    image = picture(3, 4, 4)
    change = {"brightness": 1.4, "contrast": 0.4}
    first = recolor(image, RecolorParameters(**change, order=("brightness", "contrast", "saturation", "hue")))
    second = recolor(image, RecolorParameters(**change, order=("contrast", "brightness", "saturation", "hue")))
    assert (first - second).abs().max() > 0.1


def test_gradients_reach_the_image():
    image = (0.2 + 0.6 * picture(3, 2, 2, dtype=torch.float64)).requires_grad_()
    parameters = RecolorParameters(brightness=0.9, contrast=1.1, saturation=0.8, gamma=1.2, lighting=(0.01, 0, 0))
    assert torch.autograd.gradcheck(lambda x: recolor(x, parameters), image, atol=1e-5)


def test_greyscale_has_equal_channels():
    grey = to_greyscale(picture(2, 3, 3, 3))
    assert torch.equal(grey[:, 0], grey[:, 1]) and torch.equal(grey[:, 0], grey[:, 2])
