"""The Gaussians while they are fitted: unconstrained numbers, Adam's moments, and rows that come and go."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.rotations import normalise_quats
from edit3r.types import Gaussians

__all__ = ["Cloud", "Rows"]

OPACITY_RANGE = (1e-4, 1 - 1e-4)  # outside, the logit has no useful gradient
EPSILON = 1e-15  # of Adam; gradients of single Gaussians are tiny (3D Gaussian Splatting, released code)
MOMENTS = ("exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class Rows:
    """Gaussians of one scene in the optimiser's own numbers, one row each."""

    means: Float[Tensor, "gaussian 3"]
    scales: Float[Tensor, "gaussian 3"]  # logarithms
    quats: Float[Tensor, "gaussian 4"]  # of any norm
    opacities: Float[Tensor, "gaussian"]  # logits
    colour: Float[Tensor, "gaussian 1 3"]  # constant harmonic
    detail: Float[Tensor, "gaussian rest 3"]  # harmonics above it

    @staticmethod
    def of(gaussians: Gaussians, degree: int) -> "Rows":
        """Rows of a batch of one, harmonics cut or filled up with 0 to `degree`."""
        harmonics = gaussians.harmonics[0].detach()
        wanted = (degree + 1) ** 2
        missing = harmonics.new_zeros(len(harmonics), max(0, wanted - harmonics.shape[1]), 3)
        harmonics = torch.cat((harmonics, missing), 1)[:, :wanted]
        smallest = torch.finfo(harmonics.dtype).tiny
        return Rows(
            gaussians.means[0].detach().clone(),
            gaussians.scales[0].detach().clamp(min=smallest).log(),
            gaussians.quats[0].detach().clone(),
            gaussians.opacities[0].detach().clamp(*OPACITY_RANGE).logit(),
            harmonics[:, :1].clone(),
            harmonics[:, 1:].clone(),
        )

    def __getitem__(self, index: Tensor) -> "Rows":
        return Rows(**{name: value[index] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.means)


class Cloud:
    """Rows, and Adam over them with one step size per kind of number."""

    def __init__(self, gaussians: Gaussians, degree: int) -> None:
        self.origin = gaussians.view_index.clone()  # the input view each came from; children take their parent's
        values = vars(Rows.of(gaussians, degree))
        groups = [{"name": name, "params": [value.requires_grad_(True)], "lr": 0.0} for name, value in values.items()]
        self._optimizer = torch.optim.Adam(groups, eps=EPSILON)

    @property
    def rows(self) -> Rows:
        """The numbers themselves, with gradients where they are recorded."""
        return Rows(**{group["name"]: group["params"][0] for group in self._optimizer.param_groups})

    def __len__(self) -> int:
        return len(self.origin)

    def gaussians(self, degree: int | None = None) -> Gaussians:
        """A batch of one, harmonics up to `degree` (None: all); differentiable in the rows."""
        rows = self.rows
        harmonics = torch.cat((rows.colour, rows.detail), 1)
        return Gaussians(
            rows.means[None],
            rows.scales.exp()[None],
            normalise_quats(rows.quats)[None],
            rows.opacities.sigmoid()[None],
            harmonics[None, :, : None if degree is None else (degree + 1) ** 2],
            self.origin,
        )

    def gradients(self, loss: Float[Tensor, ""]) -> Rows:
        """Gradient of `loss` by every row; 0 where it does not depend on it."""
        rows = vars(self.rows)
        found = torch.autograd.grad(loss, list(rows.values()), allow_unused=True)
        pairs = zip(rows.items(), found)
        return Rows(**{n: torch.zeros_like(value) if g is None else g for (n, value), g in pairs})

    def step(self, gradients: Rows, sizes: Mapping[str, float]) -> None:
        """One step of Adam."""
        for group in self._optimizer.param_groups:
            group["lr"] = sizes[group["name"]]
            group["params"][0].grad = getattr(gradients, group["name"])
        self._optimizer.step()

    def keep(self, chosen: Bool[Tensor, "gaussian"]) -> None:
        """Drop all other rows; those that stay keep their moments."""
        self.origin = self.origin[chosen]
        self._change(lambda name, tensor: tensor[chosen], lambda name, moment: moment[chosen])

    def append(self, rows: Rows, origin: Tensor) -> None:
        """Add rows with moments of 0."""
        self.origin = torch.cat((self.origin, origin))
        self._change(
            lambda name, tensor: torch.cat((tensor, getattr(rows, name))),
            lambda name, moment: torch.cat((moment, torch.zeros_like(getattr(rows, name)))),
        )

    def cap_opacities(self, most: float) -> None:
        """Lower opacities to at most `most` and forget where they were heading."""
        limit = torch.tensor(most).logit().item()
        self._change(
            lambda name, tensor: tensor.clamp(max=limit) if name == "opacities" else tensor,
            lambda name, moment: torch.zeros_like(moment) if name == "opacities" else moment,
        )

    def moments(self, name: str) -> dict[str, Tensor]:
        """Adam's running means of gradient and squared gradient of one group; {} before the first step."""
        group = next(group for group in self._optimizer.param_groups if group["name"] == name)
        state = self._optimizer.state.get(group["params"][0], {})
        return {moment: state[moment] for moment in MOMENTS if moment in state}

    def state(self) -> dict[str, Any]:
        """All that the next steps depend on."""
        return {
            "rows": {name: value.detach().clone() for name, value in vars(self.rows).items()},
            "origin": self.origin.clone(),
            "adam": deepcopy(self._optimizer.state_dict()),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue where `state` was taken."""
        self.origin = state["origin"]
        self._change(lambda name, tensor: state["rows"][name], lambda name, moment: moment)
        self._optimizer.load_state_dict(deepcopy(state["adam"]))

    @torch.no_grad()
    def _change(self, of_values, of_moments) -> None:
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
    """Without history."""
    names = ("means", "scales", "quats", "opacities", "harmonics")
    return replace(gaussians, **{name: getattr(gaussians, name).detach() for name in names})
