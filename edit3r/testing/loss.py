"""Contract of a loss."""

from dataclasses import fields, replace

import torch
from torch import Tensor

from edit3r.interfaces import Loss, LossInputs
from edit3r.testing.contract import Contract
from edit3r.testing.scenes import gaussian_cloud, photograph
from edit3r.types import Gaussians

GAUSSIAN_FIELDS = tuple(field.name for field in fields(Gaussians) if field.name != "view_index")


class LossContract(Contract):
    """A finite scalar, zero at the target, positive away from it, with finite gradients at both."""

    kind = "loss"
    subject: Loss
    image_size: tuple[int, int] = (48, 64)  # (height, width) [pixels]
    zero: float = 1e-5  # what counts as zero at the target

    def test_zero_at_the_target(self) -> None:
        value = self._value(self._inputs(distance=0)).item()
        self.require(abs(value) <= self.zero, f"at the target it is {value:.4g}; subtract its minimum, it must be 0.")

    def test_positive_away_from_the_target(self) -> None:
        value = self._value(self._inputs(distance=0.2)).item()
        self.require(value > self.zero, f"away from the target it is {value:.4g}; it must grow with the difference.")

    def test_gradients_are_finite(self) -> None:
        for distance, place in ((0.2, "away from the target"), (0.0, "at the target")):
            inputs, leaves = _with_gradients(self._inputs(distance))
            value = self._value(inputs)
            self.require(value.requires_grad, "it carries no gradient; compute it from inputs.rendered or .gaussians.")
            gradients = [g for g in torch.autograd.grad(value, leaves, allow_unused=True) if g is not None]
            finite = all(bool(torch.isfinite(gradient).all()) for gradient in gradients)
            self.require(finite, f"its gradient {place} is not finite; use a smooth norm, sqrt(x) has none at 0.")
            moves = any(gradient.abs().max() > 0 for gradient in gradients)
            self.require(distance == 0 or moves, f"its gradient {place} is zero; it would teach nothing.")

    def test_leaves_its_inputs_alone(self) -> None:
        inputs = self._inputs(distance=0.2)
        before = inputs.rendered.clone()
        self._value(inputs)
        self.require_equal("it changed inputs.rendered", inputs.rendered, before, "do not use in-place operations")

    def _value(self, inputs: LossInputs) -> Tensor:
        value = self.call("the loss", self.subject, inputs)
        self.require_tensor("the loss", value, ())
        return value

    def _inputs(self, distance: float) -> LossInputs:
        """Pictures and Gaussians that lie `distance` from their targets."""
        target = photograph(2, self.image_size, batch=2).views.images.to(self.device)
        reference = _dense_gaussians(target.shape[1] * 24).to(self.device)
        generator = torch.Generator().manual_seed(5)
        noise = torch.rand(target.shape, generator=generator).to(self.device)
        shift = torch.randn(reference.means.shape, generator=generator).to(self.device)
        return LossInputs(
            rendered=(1 - distance) * target + distance * noise,
            target=target,
            gaussians=replace(
                reference, means=reference.means + distance * shift, scales=reference.scales * (1 + distance)
            ),
            reference=reference,
        )


def _dense_gaussians(count: int) -> Gaussians:
    """Gaussians of two scenes that came from two views in turn, half each."""
    cloud = gaussian_cloud(count, batch=2)
    return replace(cloud, view_index=torch.arange(2).repeat_interleave(count // 2))


def _with_gradients(inputs: LossInputs) -> tuple[LossInputs, list[Tensor]]:
    """The same inputs with the prediction's tensors as leaves."""
    rendered = inputs.rendered.clone().requires_grad_()
    leaves = {name: getattr(inputs.gaussians, name).clone().requires_grad_() for name in GAUSSIAN_FIELDS}
    gaussians = replace(inputs.gaussians, **leaves)
    return replace(inputs, rendered=rendered, gaussians=gaussians), [rendered, *leaves.values()]
