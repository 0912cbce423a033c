"""Our Adam against torch's."""

import subprocess
import sys

import torch
from edit3r_refiners.adam import Adam


def test_steps_are_those_of_torch():
    generator = torch.Generator().manual_seed(0)
    start = [torch.randn(5, 3, generator=generator), torch.randn(4, generator=generator)]
    ours, theirs = ([value.clone().requires_grad_(True) for value in start] for _ in range(2))
    adam, reference = Adam(ours, [0.1, 1e-3]), torch.optim.Adam(
        [{"params": [value], "lr": rate} for value, rate in zip(theirs, [0.1, 1e-3])]
    )  # fmt: skip
    for _ in range(20):
        gradients = [torch.randn(value.shape, generator=generator) ** 3 for value in start]
        adam.step(gradients)
        for value, gradient in zip(theirs, gradients):
            value.grad = gradient
        reference.step()
    for value, expected in zip(ours, theirs):
        assert torch.equal(value, expected)


def test_a_gradient_of_zero_moves_nothing():
    value = torch.ones(3)
    Adam([value], [0.1]).step([torch.zeros(3)])
    assert torch.equal(value, torch.ones(3))


def test_no_compiler_is_loaded():
    code = (
        "import sys, torch; from edit3r_refiners.adam import Adam; Adam([torch.ones(1)], [1.0]).step([torch.ones(1)])"
    )
    code += "; sys.exit('torch._dynamo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
