import kornia
import torch

from edit3r.kit.compute.colour import rgb_to_lab


def test_lab_is_that_of_kornia():
    pixels = torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(rgb_to_lab(pixels), kornia.color.rgb_to_lab(pixels))
