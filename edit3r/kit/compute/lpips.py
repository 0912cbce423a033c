"""LPIPS by the shift-tolerant AlexNet of Ghildyal and Liu (ECCV 2022).

Poses of a pair are off by a fraction of a degree, and a sharp picture a pixel beside its place is
no worse to look at. The weights are a file of the package `stlpips-pytorch` (BSD-2-Clause;
`pip install "edit3r[stlpips]"`), whose own code needs torchvision. The figures do not compare with
those of other LPIPS.
"""

import importlib.metadata
import importlib.util
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import MissingDependencyError
from edit3r.kit.compute.metrics import Image

__all__ = ["PACKAGE", "lpips_distance", "lpips_distances", "lpips_weights"]

PACKAGE, FILE = "stlpips_pytorch", "weights/vST0.0/alex_shift_tolerant.pth"
# Convolutions by their names in the file, with what is padded; features are compared after each.
CONVOLUTIONS = {
    "slice1.0": 2,
    "slice2.5": 2,
    "slice3.9": 1,
    "slice4.11": 1,
    "slice5.13": 1,
}
# The constants are those of the package's code.
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of images in [-1, 1]
# before every second pixel is taken; from the package's code
BLUR, PADDING = (0.25, 0.5, 0.25), 2

Images = Float[Tensor, "n 3 height width"]


def lpips_weights() -> str:
    """The package and version that LPIPS is measured with; "" where it is not installed."""
    if importlib.util.find_spec(PACKAGE) is None:
        return ""
    name = PACKAGE.replace("_", "-")
    return f"shift-tolerant AlexNet of {name} {importlib.metadata.version(name)}"


def lpips_distances(images: Images, photos: Images) -> Float[Tensor, "n"]:
    """Return the distances of images in [0, 1] of one size, with gradients; 0 for equal ones.

    Raises MissingDependencyError where the package of the weights is not installed.
    """
    weights = _weights(images.device)
    distances = [
        F.conv2d((a - b).square(), weights[f"lin{layer}.model.1.weight"]).mean(
            (1, 2, 3)
        )
        for layer, (a, b) in enumerate(zip(_features(images), _features(photos)))
    ]
    return torch.stack(distances).sum(0)


@torch.no_grad()
def lpips_distance(image: Image, photo: Image) -> float:
    """Return the distance of two images `[height, width, 3]`. Raises as `lpips_distances` does."""
    batches = (
        torch.from_numpy(np.ascontiguousarray(own)).float().permute(2, 0, 1)[None]
        for own in (image, photo)
    )
    return float(lpips_distances(*batches))


def _features(images: Images) -> list[Tensor]:
    """What each convolution gives, every pixel's features of length 1."""
    weights, features = _weights(images.device), []
    shift, scale = (images.new_tensor(v)[:, None, None] for v in (SHIFT, SCALE))
    x = (2 * images - 1 - shift) / scale
    for layer, (name, padding) in enumerate(CONVOLUTIONS.items()):
        if layer in (1, 2):
            x = _halved(F.max_pool2d(x, 3, stride=1))
        kernel, bias = (weights[f"net.{name}.{part}"] for part in ("weight", "bias"))
        x = F.conv2d(x, kernel, bias, padding=padding)
        x = F.relu(_halved(x) if layer == 0 else x)
        features.append(F.normalize(x, dim=1, eps=1e-10))
    return features


def _halved(x: Tensor) -> Tensor:
    """Blurred, at every second pixel."""
    row = x.new_tensor(BLUR)
    kernel = (row[:, None] * row).expand(x.shape[1], 1, 3, 3)
    padded = F.pad(x, (PADDING,) * 4, mode="reflect")
    return F.conv2d(padded, kernel, stride=2, groups=x.shape[1])


@cache
def _weights(device: torch.device) -> dict[str, Tensor]:
    """The file of the installed package, whose code does not run."""
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None:
        raise MissingDependencyError(
            f'LPIPS needs {PACKAGE}; install with: pip install "edit3r[stlpips]"'
        )
    file = Path(next(iter(spec.submodule_search_locations or ()))) / FILE
    return torch.load(file, map_location=device, weights_only=True)
