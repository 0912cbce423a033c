"""Low-frequency MSE: colour, exposure and illumination, tolerant to small reprojection errors (L_MSE)."""

import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.interfaces import Loss, LossInputs
from edit3r_training.losses.needs import require


class MseLoss(Loss):
    """Mean squared difference of pictures averaged over `cell` x `cell` pixels."""

    class Settings(config.Settings):
        cell: int = Field(4, ge=1, le=64, description="pixels averaged along each side before comparing; 1: plain MSE")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require(inputs, "mse", "rendered", "target")
        difference = (inputs.rendered - inputs.target).flatten(0, 1)
        cell = min(self.settings.cell, *difference.shape[-2:])
        return F.avg_pool2d(difference, cell, ceil_mode=True).square().mean()
