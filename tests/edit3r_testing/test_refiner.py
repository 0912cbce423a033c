"""The refiner's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Refiner
from edit3r_testing import RefinerContract


class Spoiled(Refiner):
    """Returns the Gaussians it is given, changed by a function of Gaussians and inputs."""

    def __init__(self, change):
        self.change = change

    def __call__(self, gaussians, inputs):
        return self.change(gaussians, inputs)


def in_place(gaussians, inputs):
    gaussians.opacities.mul_(0.5)
    return gaussians


def refuse_masks(gaussians, inputs):
    if inputs.masks is not None:
        raise TypeError("masks are not supported")
    return gaussians


VALID, MASKS = "test_refined_gaussians_are_valid", "test_masks_of_the_edit_are_accepted"
FRAME, SAME = (
    "test_the_scene_stays_in_its_frame",
    "test_same_input_gives_the_same_result",
)
INPUTS = "test_leaves_its_inputs_alone"
CASES = {
    "another type": (
        lambda g, _: g.means,
        VALID,
        "return edit3r.contract.types.Gaussians",
    ),
    "logits": (
        lambda g, _: replace(g, opacities=g.opacities * 5),
        VALID,
        "return opacities in [0, 1]",
    ),
    "no masks": (refuse_masks, MASKS, "masks are not supported"),
    "another frame": (
        lambda g, _: replace(g, means=g.means + torch.tensor([3.0, 0, 0])),
        FRAME,
        "frame of view 0",
    ),
    "chance": (
        lambda g, _: replace(g, means=g.means + 0.01 * torch.randn(g.means.shape)),
        SAME,
        "seeded",
    ),
    "writing into its input": (in_place, INPUTS, "work on a copy"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_refiner_broken_by(case, complaint):
    change, claim, advice = CASES[case]
    assert advice in complaint(RefinerContract, lambda: Spoiled(change), claim)


def test_every_claim_about_refiners_can_fail():
    own = {name for name in vars(RefinerContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}


def test_one_that_changes_nothing_keeps_the_contract():
    for claim in CASES.values():
        bound = type(
            "Bound", (RefinerContract,), {"build": lambda self: Spoiled(lambda g, _: g)}
        )
        getattr(bound(), claim[1])()
