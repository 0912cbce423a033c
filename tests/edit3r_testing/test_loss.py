"""The loss's contract finds every way of breaking it."""

import pytest
import torch

from edit3r.contract.interfaces import Loss
from edit3r_testing import LossContract


class Formula(Loss):
    def __init__(self, formula):
        self.formula = formula

    def __call__(self, inputs):
        return self.formula(inputs)


def in_place(inputs):
    with torch.no_grad():
        inputs.rendered.mul_(0.9)
    return (inputs.rendered - inputs.target).square().mean()


LESS, GRADIENT, ALONE = (
    "test_less_at_the_target_than_away_from_it",
    "test_gradients_are_finite",
    "test_leaves_its_inputs_alone",
)
CASES = {
    "one value per picture": (
        lambda i: (i.rendered - i.target).square().mean((2, 3, 4)),
        LESS,
        "return one number, of shape []",
    ),
    "a number": (
        lambda i: (i.rendered - i.target).square().mean().item(),
        LESS,
        "return torch.Tensor, got float",
    ),
    "NaN": (lambda i: (i.rendered - i.target).sum() / 0, LESS, "NaN"),
    "blind": (
        lambda i: (i.rendered * 0).sum(),
        GRADIENT,
        "it would teach nothing",
    ),
    "the wrong sign": (
        lambda i: -(i.rendered - i.target).square().mean(),
        LESS,
        "must grow",
    ),
    "detached": (
        lambda i: (i.rendered.detach() - i.target).square().mean(),
        GRADIENT,
        "carry gradients",
    ),
    "a root at 0": (
        lambda i: (i.rendered - i.target).norm(dim=2).pow(2).mean().sqrt(),
        GRADIENT,
        "use a smooth norm",
    ),
    "steps": (
        lambda i: (i.rendered - i.target).round().square().mean(),
        GRADIENT,
        "it would teach nothing",
    ),
    "in place": (in_place, ALONE, "its input was changed"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_loss_broken_by(case, complaint):
    formula, claim, advice = CASES[case]
    assert advice in complaint(LossContract, lambda: Formula(formula), claim)


@pytest.mark.parametrize(
    "rule",
    [
        lambda i: i.gaussians.opacities.mean(),
        lambda i: (1 - i.rendered).abs().mean() - 1,
        lambda i: (i.rendered - i.target).square().mean() + 1,
    ],
)
def test_a_rule_of_the_scene_alone_and_an_offset_are_losses(rule):
    bound = type("Bound", (LossContract,), {"build": lambda self: Formula(rule)})
    for claim in {claim for _, claim, _ in CASES.values()}:
        getattr(bound(), claim)()


def test_every_claim_about_losses_can_fail():
    own = {name for name in vars(LossContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
