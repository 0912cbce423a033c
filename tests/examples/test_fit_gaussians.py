"""The example that fits Gaussians to an image with the rasterizer alone."""

from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest
import torch

SCRIPT = Path(__file__).parents[2] / "examples" / "fit_gaussians.py"
example = SourceFileLoader("fit_gaussians", str(SCRIPT)).load_module()


@pytest.mark.slow
def test_gaussians_come_to_look_like_the_image():
    torch.manual_seed(0)
    image = torch.zeros(24, 32, 3)
    image[:, 16:, 0] = 1  # black beside red
    shown, errors = example.fit(image, 60, 60)
    assert errors[-1] < 0.2 * errors[0]
    assert (shown - image).square().mean().item() == errors[-1]
