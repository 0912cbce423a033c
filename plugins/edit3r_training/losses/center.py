"""Center-matching loss: every Gaussian stays near its reference location (L_center)."""

import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.interfaces import Loss, LossInputs
from edit3r_training.losses.needs import require


class CenterLoss(Loss):
    """Smooth L1 between predicted and reference centres, Gaussian by Gaussian."""

    class Settings(config.Settings):
        beta: float = Field(1.0, gt=0, description="distance at which the square turns linear [scene units]")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require(inputs, "center", "gaussians", "reference")
        return F.smooth_l1_loss(inputs.gaussians.means, inputs.reference.means, beta=self.settings.beta)
