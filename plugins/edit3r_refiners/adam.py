"""Adam (Kingma and Ba 2015) with torch's defaults, in ten lines.

`torch.optim` computes the same, but its first optimizer of a process imports torch's compiler: two seconds, more than
all steps of a usual refinement together.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

BETAS = (0.9, 0.999)
EPSILON = 1e-8


class Adam:
    """Moves `values` in place; `rates` are their step sizes."""

    def __init__(self, values: Sequence[Tensor], rates: Sequence[float]) -> None:
        self.values, self.rates, self.steps = list(values), list(rates), 0
        self.first, self.second = ([torch.zeros_like(value) for value in self.values] for _ in range(2))

    @torch.no_grad()
    def step(self, gradients: Sequence[Tensor]) -> None:
        """One step against the gradients, in the order of the values."""
        self.steps += 1
        unbiased = [1 - beta**self.steps for beta in BETAS]
        for value, rate, gradient, first, second in zip(self.values, self.rates, gradients, self.first, self.second):
            first.lerp_(gradient, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1 - BETAS[1])
            spread = second.sqrt().div_(math.sqrt(unbiased[1])).add_(EPSILON)
            value.addcdiv_(first, spread, value=-rate / unbiased[0])
