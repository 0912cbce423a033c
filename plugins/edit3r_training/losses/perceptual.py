"""Perceptual loss on the features of an ImageNet network that installs from the package index and works offline.

EfficientNet-lite0 (Apache-2.0) instead of VGG: it plays LPIPS's part but its numbers do not compare with LPIPS.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.interfaces import Loss, LossInputs
from edit3r.perceptual import frozen_efficientnet
from edit3r_training.losses.needs import require

_BLOCKS = (0, 2, 4, 10)
"""Blocks whose outputs are compared: strides 2, 4, 8 and 16."""


class PerceptualLoss(Loss):
    """Mean squared distance of channel-normalised features at four strides, averaged over the strides."""

    class Settings(config.Settings):
        size: int = Field(128, ge=32, le=512, description="pictures are resized to this before comparing [pixels]")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._network = frozen_efficientnet()

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require(inputs, "perceptual", "rendered", "target")
        predicted = self._features(inputs.rendered)
        with torch.no_grad():
            wished = self._features(inputs.target)
        return sum(F.mse_loss(p, w) * p.shape[1] for p, w in zip(predicted, wished)) / len(predicted)

    def _features(self, images: Float[Tensor, "batch view 3 height width"]) -> list[Tensor]:
        size = (self.settings.size, self.settings.size)
        x = F.interpolate(images.flatten(0, 1), size, mode="bilinear", align_corners=False, antialias=True)
        x = (x * 255 - 127) / 128
        network = self._network.to(x.device)
        x = network._swish(network._bn0(network._conv_stem(x)))
        features = []
        for index, block in enumerate(network._blocks[: _BLOCKS[-1] + 1]):
            x = block(x)
            if index in _BLOCKS:
                features.append(x / (x.square().sum(1, keepdim=True) + 1e-6).sqrt())
        return features
