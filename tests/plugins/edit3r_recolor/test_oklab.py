import kornia
import pytest
import torch
from edit3r_recolor.oklab import oklab_to_rgb, rgb_to_oklab


def pixels() -> torch.Tensor:
    return torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    "rgb, oklab",
    [
        ((1, 1, 1), (1, 0, 0)),
        ((1, 0, 0), (0.62796, 0.22486, 0.12585)),
        ((0, 0, 1), (0.45201, -0.03246, -0.31153)),
    ],
)
def test_oklab_is_that_of_its_author(rgb, oklab):
    image = torch.tensor(rgb, dtype=torch.float64)[:, None, None]
    expected = torch.tensor(oklab, dtype=torch.float64)[:, None, None]
    torch.testing.assert_close(rgb_to_oklab(image), expected, atol=1e-4, rtol=0)


def test_oklab_and_back_is_the_same_colour():
    lab = rgb_to_oklab(pixels())
    torch.testing.assert_close(oklab_to_rgb(lab), pixels(), atol=2e-5, rtol=0)


def test_half_the_light_keeps_chroma_over_lightness():
    linear = kornia.color.rgb_to_linear_rgb(pixels())
    shaded = kornia.color.linear_rgb_to_rgb(0.5 * linear)
    full, half = rgb_to_oklab(pixels()), rgb_to_oklab(shaded)
    torch.testing.assert_close(
        full[:, 1:] / full[:, :1], half[:, 1:] / half[:, :1], atol=1e-3, rtol=0
    )
