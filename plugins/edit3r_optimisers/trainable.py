"""Gaussians while they are fitted: unconstrained parameters, Adam's moments, and Gaussians that come and go."""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.geometry.rotations import normalise_quats
from edit3r.types import Gaussians

OPACITY_RANGE = (1e-4, 1 - 1e-4)  # outside, the logit has no useful gradient
EPSILON = 1e-15  # of Adam; gradients of single Gaussians are tiny (3D Gaussian Splatting, released code)
MOMENTS = ("exp_avg", "exp_avg_sq")

Change = Callable[[str, Tensor], Tensor]
"""A function from a parameter's name and tensor to the new tensor."""


@dataclass(frozen=True)
class Parameters:
    """Unconstrained parameters of the Gaussians of one scene, one row each."""

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

    def __getitem__(self, index: Tensor) -> "Parameters":
        return Parameters(**{name: value[index] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.means)


class TrainableGaussians:
    """The parameters of one scene, and Adam over them with one step size per kind of parameter."""

    def __init__(self, gaussians: Gaussians, degree: int) -> None:
        self.view_index = gaussians.view_index.clone()  # children take their parent's
        values = vars(Parameters.of(gaussians, degree))
        groups = [{"name": name, "params": [value.requires_grad_(True)], "lr": 0.0} for name, value in values.items()]
        self._optimizer = torch.optim.Adam(groups, eps=EPSILON)

    @property
    def parameters(self) -> Parameters:
        """The parameters themselves, with gradients where they are recorded."""
        return Parameters(**{group["name"]: group["params"][0] for group in self._optimizer.param_groups})

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
        values = vars(self.parameters)
        found = torch.autograd.grad(loss, list(values.values()), allow_unused=True)
        pairs = zip(values.items(), found)
        return Parameters(**{n: torch.zeros_like(value) if g is None else g for (n, value), g in pairs})

    def step(self, gradients: Parameters, sizes: Mapping[str, float]) -> None:
        """Take one step of Adam; `sizes` are the step sizes by name of the parameter."""
        for group in self._optimizer.param_groups:
            group["lr"] = sizes[group["name"]]
            group["params"][0].grad = getattr(gradients, group["name"])
        self._optimizer.step()

    def keep(self, chosen: Bool[Tensor, "gaussian"]) -> None:
        """Drop all other Gaussians; those that stay keep their moments."""
        self.view_index = self.view_index[chosen]
        self._change(lambda name, tensor: tensor[chosen], lambda name, moment: moment[chosen])

    def append(self, added: Parameters, view_index: Int[Tensor, "added"]) -> None:
        """Add Gaussians with moments of 0."""
        self.view_index = torch.cat((self.view_index, view_index))
        self._change(
            lambda name, tensor: torch.cat((tensor, getattr(added, name))),
            lambda name, moment: torch.cat((moment, torch.zeros_like(getattr(added, name)))),
        )

    def cap_opacities(self, most: float) -> None:
        """Lower opacities to at most `most` and forget where they were heading."""
        limit = torch.tensor(most).logit().item()
        self._change(
            lambda name, tensor: tensor.clamp(max=limit) if name == "opacities" else tensor,
            lambda name, moment: torch.zeros_like(moment) if name == "opacities" else moment,
        )

    def moments(self, name: str) -> dict[str, Tensor]:
        """Return Adam's running means of gradient and squared gradient of one group; {} before the first step."""
        group = next(group for group in self._optimizer.param_groups if group["name"] == name)
        state = self._optimizer.state.get(group["params"][0], {})
        return {moment: state[moment] for moment in MOMENTS if moment in state}

    def state(self) -> dict[str, Any]:
        """Return all that the next steps depend on."""
        return {
            "parameters": {name: value.detach().clone() for name, value in vars(self.parameters).items()},
            "view_index": self.view_index.clone(),
            "adam": deepcopy(self._optimizer.state_dict()),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from what `state` returned."""
        self.view_index = state["view_index"]
        self._change(lambda name, tensor: state["parameters"][name], lambda name, moment: moment)
        self._optimizer.load_state_dict(deepcopy(state["adam"]))

    @torch.no_grad()
    def _change(self, of_values: Change, of_moments: Change) -> None:
        """Replace every group's tensor and move its moments along."""
        for group in self._optimizer.param_groups:
            name, old = group["name"], group["params"][0]
            new = of_values(name, old.detach()).clone().requires_grad_(True)
            state = self._optimizer.state.pop(old, None)
            if state is not None:
                moved = {moment: of_moments(name, state[moment]) for moment in MOMENTS}
                self._optimizer.state[new] = {**state, **moved}
            group["params"] = [new]


def detached(gaussians: Gaussians) -> Gaussians:
    """Return the Gaussians without gradient history."""
    names = ("means", "scales", "quats", "opacities", "harmonics")
    return replace(gaussians, **{name: getattr(gaussians, name).detach() for name in names})
