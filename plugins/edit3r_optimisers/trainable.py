"""Gaussians while they are fitted: unconstrained parameters, Adam's moments, and Gaussians that come and go."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.geometry.rotations import normalise_quats
from edit3r.types import Gaussians

OPACITY_RANGE = (1e-4, 1 - 1e-4)  # outside, the logit has no useful gradient
BETAS, EPSILON = (0.9, 0.999), 1e-15  # of Adam; gradients of single Gaussians are tiny (3DGS, released code)


@dataclass(frozen=True)
class Parameters:
    """Unconstrained parameters of the Gaussians of one scene, or a number for each of them, one row per Gaussian."""

    means: Float[Tensor, "gaussian 3"]
    scales: Float[Tensor, "gaussian 3"]  # logarithms
    quats: Float[Tensor, "gaussian 4"]  # of any norm
    opacities: Float[Tensor, "gaussian"]  # logits
    colour: Float[Tensor, "gaussian 1 3"]  # constant harmonic
    detail: Float[Tensor, "gaussian rest 3"]  # harmonics above it

    @staticmethod
    def of(gaussians: Gaussians, degree: int) -> "Parameters":
        """Take the parameters of one scene (batch 1), harmonics cut or filled up with 0 to `degree`."""
        harmonics = gaussians.harmonics[0].detach()
        wanted = (degree + 1) ** 2
        missing = harmonics.new_zeros(len(harmonics), max(0, wanted - harmonics.shape[1]), 3)
        harmonics = torch.cat((harmonics, missing), 1)[:, :wanted]
        smallest = torch.finfo(harmonics.dtype).tiny
        return Parameters(
            gaussians.means[0].detach().clone(),
            gaussians.scales[0].detach().clamp(min=smallest).log(),
            gaussians.quats[0].detach().clone(),
            gaussians.opacities[0].detach().clamp(*OPACITY_RANGE).logit(),
            harmonics[:, :1].clone(),
            harmonics[:, 1:].clone(),
        )

    def map(self, function: Callable[..., Tensor], *others: "Parameters") -> "Parameters":
        """Apply `function` to each tensor, together with those of the same name in `others`."""
        rows = (vars(parameters).values() for parameters in (self, *others))
        return Parameters(*(function(*tensors) for tensors in zip(*rows)))

    def __getitem__(self, index: Tensor) -> "Parameters":
        return self.map(lambda value: value[index])

    def __len__(self) -> int:
        return len(self.means)


class TrainableGaussians:
    """The parameters of one scene, and Adam over them with one step size per kind of parameter."""

    def __init__(self, gaussians: Gaussians, degree: int) -> None:
        self.view_index = gaussians.view_index.clone()  # children take their parent's
        self.parameters = Parameters.of(gaussians, degree).map(lambda value: value.requires_grad_(True))
        self.first, self.second = (self.parameters.map(torch.zeros_like) for _ in range(2))  # moments of the gradient
        self.steps = 0

    def __len__(self) -> int:
        return len(self.view_index)

    def gaussians(self, degree: int | None = None) -> Gaussians:
        """Return a batch of one, harmonics up to `degree` (None: all); differentiable in the parameters."""
        parameters = self.parameters
        harmonics = torch.cat((parameters.colour, parameters.detail), 1)
        return Gaussians(
            parameters.means[None],
            parameters.scales.exp()[None],
            normalise_quats(parameters.quats)[None],
            parameters.opacities.sigmoid()[None],
            harmonics[None, :, : None if degree is None else (degree + 1) ** 2],
            self.view_index,
        )

    def gradients(self, loss: Float[Tensor, ""]) -> Parameters:
        """Return the gradient of `loss` by every parameter; 0 where it does not depend on it."""
        values = list(vars(self.parameters).values())
        found = torch.autograd.grad(loss, values, allow_unused=True)
        return Parameters(*(torch.zeros_like(value) if g is None else g for value, g in zip(values, found)))

    @torch.no_grad()
    def step(self, gradients: Parameters, sizes: Mapping[str, float]) -> None:
        """Take one step of Adam in place; `sizes` are the step sizes by name of the parameter."""
        self.steps += 1
        unbiased = [1 - beta**self.steps for beta in BETAS]
        for name, size in sizes.items():
            gradient, first, second = (getattr(p, name) for p in (gradients, self.first, self.second))
            first.lerp_(gradient, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1 - BETAS[1])
            spread = second.sqrt().div_(unbiased[1] ** 0.5).add_(EPSILON)
            getattr(self.parameters, name).addcdiv_(first, spread, value=-size / unbiased[0])

    def keep(self, chosen: Bool[Tensor, "gaussian"]) -> None:
        """Drop all other Gaussians; those that stay keep their moments."""
        self._replace(self.parameters[chosen], self.view_index[chosen], self.first[chosen], self.second[chosen])

    def append(self, added: Parameters, view_index: Int[Tensor, "added"]) -> None:
        """Add Gaussians with moments of 0."""
        none = added.map(torch.zeros_like)
        pairs = (self.parameters, added), (self.first, none), (self.second, none)
        grown, *moments = (old.map(lambda *both: torch.cat(both), new) for old, new in pairs)
        self._replace(grown, torch.cat((self.view_index, view_index)), *moments)

    def cap_opacities(self, most: float) -> None:
        """Lower opacities to at most `most` and forget where they were heading."""
        capped = self.parameters.opacities.clamp(max=torch.tensor(most).logit().item())
        zero = torch.zeros_like(capped)
        moments = (replace(moment, opacities=zero.clone()) for moment in (self.first, self.second))
        self._replace(replace(self.parameters, opacities=capped), self.view_index, *moments)

    def state(self) -> dict[str, Any]:
        """Return all that the next steps depend on."""
        kept = {"parameters": self.parameters, "first": self.first, "second": self.second}
        copies = {name: vars(part.map(lambda value: value.detach().clone())) for name, part in kept.items()}
        return {**copies, "view_index": self.view_index.clone(), "steps": self.steps}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what `state` returned."""
        parameters, first, second = (Parameters(**state[name]) for name in ("parameters", "first", "second"))
        self._replace(parameters, state["view_index"], first, second)
        self.steps = state["steps"]

    def _replace(self, parameters: Parameters, view_index: Tensor, first: Parameters, second: Parameters) -> None:
        """Take copies, so that steps in place change nothing else."""
        self.parameters = parameters.map(lambda value: value.detach().clone().requires_grad_(True))
        self.first, self.second = (moment.map(torch.clone) for moment in (first, second))
        self.view_index = view_index


def detached(gaussians: Gaussians) -> Gaussians:
    """Return the Gaussians without gradient history."""
    names = ("means", "scales", "quats", "opacities", "harmonics")
    return replace(gaussians, **{name: getattr(gaussians, name).detach() for name in names})
