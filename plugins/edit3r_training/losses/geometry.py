"""Multi-view geometry loss: Chamfer distance between the views' centres (L_geom).

L_geom = 1 / (V (V - 1)) sum_{i < j} Chamfer_L1(mu_i, mu_j) over random samples, with the factor as the paper writes it.
Views do not show quite the same surface, so even the truth has a distance: with a reference its own is subtracted,
which leaves the gradient as it is and makes the reference worth 0.
"""

from itertools import combinations

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.interfaces import Loss, LossInputs
from edit3r_training.losses.needs import require


class GeometryLoss(Loss):
    """Mean pairwise Chamfer-L1 of at most `samples` random centres a view."""

    class Settings(config.Settings):
        samples: int = Field(512, ge=1, le=8192, description="centres drawn from each view")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        require(inputs, "geometry", "gaussians")
        chosen = self._sample(inputs.gaussians.view_index)
        value = pairwise_chamfer(inputs.gaussians.means, chosen)
        if inputs.reference is None:
            return value
        return value - pairwise_chamfer(inputs.reference.means, chosen).detach()

    def _sample(self, view_index: Tensor) -> list[Tensor]:
        """Indices along G of the centres drawn from each view."""
        views = [torch.nonzero(view_index == view).flatten() for view in view_index.unique() if view >= 0]
        return [own[torch.randperm(len(own), device=own.device)[: self.settings.samples]] for own in views]


def pairwise_chamfer(means: Float[Tensor, "batch gaussian 3"], views: list[Tensor]) -> Float[Tensor, ""]:
    """1 / (V (V - 1)) times the sum over pairs of views."""
    count = len(views)
    if count < 2:
        return means.sum() * 0
    pairs = [chamfer_l1(means[:, a], means[:, b]) for a, b in combinations(views, 2)]
    return sum(pairs) / (count * (count - 1))


def chamfer_l1(a: Float[Tensor, "batch point 3"], b: Float[Tensor, "batch point2 3"]) -> Float[Tensor, ""]:
    """Mean L1 distance to the nearest point of the other set, both ways."""
    distances = torch.cdist(a, b, p=1)
    return distances.min(2).values.mean() + distances.min(1).values.mean()
