"""Gaussians while they are fitted: unconstrained parameters under Adam."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.rotations import normalise_quats
from edit3r.types import Gaussians

OPACITY_RANGE = (1e-4, 1 - 1e-4)  # outside, the logit has no useful gradient
BETAS, EPSILON = (0.9, 0.999), 1e-15  # of Adam; gradients of single Gaussians are tiny (3DGS, released code)


def unconstrained(gaussians: Gaussians) -> dict[str, Float[Tensor, "gaussian *shape"]]:
    """Return the parameters of one scene (batch 1).

    Scales are logarithms, opacities logits, quaternions of any norm; of the harmonics only the constant one is kept.
    """
    return {
        "means": gaussians.means[0].detach().clone(),
        "scales": gaussians.scales[0].detach().clamp(min=torch.finfo(gaussians.scales.dtype).tiny).log(),
        "quats": gaussians.quats[0].detach().clone(),
        "opacities": gaussians.opacities[0].detach().clamp(*OPACITY_RANGE).logit(),
        "colour": gaussians.harmonics[0, :, :1].detach().clone(),
    }


class TrainableGaussians:
    """The parameters of one scene, and Adam over them with one step size per kind of parameter."""

    def __init__(self, gaussians: Gaussians) -> None:
        self.view_index = gaussians.view_index
        self.parameters = unconstrained(gaussians)
        groups = [{"params": [value.requires_grad_(True)], "name": name} for name, value in self.parameters.items()]
        self.adam = torch.optim.Adam(groups, betas=BETAS, eps=EPSILON)

    def gaussians(self) -> Gaussians:
        """Return a batch of one; differentiable in the parameters."""
        values = self.parameters
        return Gaussians(
            values["means"][None],
            values["scales"].exp()[None],
            normalise_quats(values["quats"])[None],
            values["opacities"].sigmoid()[None],
            values["colour"][None],
            self.view_index,
        )

    def step(self, loss: Float[Tensor, ""], sizes: Mapping[str, float]) -> None:
        """Take one step of Adam against `loss`; `sizes` are the step sizes by name of the parameter."""
        self.adam.zero_grad()
        loss.backward()
        for group in self.adam.param_groups:
            group["lr"] = sizes[group["name"]]
        self.adam.step()


def detached(gaussians: Gaussians) -> Gaussians:
    """Return the Gaussians without gradient history."""
    names = ("means", "scales", "quats", "opacities", "harmonics")
    return replace(gaussians, **{name: getattr(gaussians, name).detach() for name in names})
