"""The matcher's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r_testing import MatcherContract, photograph


class Knowing(Matcher):
    """Answers with the truth about the contract's scenes, changed by `spoil`; refuses photos
    without texture.
    """

    def __init__(self, spoil=None, refuse=MatchingError):
        self.spoil, self.refuse = spoil, refuse

    def match(self, views):
        if views.images.std() == 0 and self.refuse is not None:
            raise self.refuse("no texture")
        scene = photograph(views.count, views.image_size)
        geometry = Geometry(
            scene.cameras.c2w,
            scene.depths,
            torch.ones_like(scene.depths),
            torch.ones(1, views.count, dtype=torch.bool),
        )
        return self.spoil(geometry) if self.spoil else geometry


def shifted(geometry):
    c2w = geometry.c2w.clone()
    c2w[..., :3, 3] += 1
    return replace(geometry, c2w=c2w)


def turned(geometry):
    c2w = geometry.c2w.clone()
    c2w[:, 1, :3, :3] = torch.eye(3)[[1, 0, 2]] * torch.tensor([1.0, 1.0, -1.0])
    return replace(geometry, c2w=c2w)


def mirrored(geometry):
    c2w = geometry.c2w.clone()
    c2w[:, 1, :3, 3] *= -1
    return replace(geometry, c2w=c2w)


VALID, PLACED = "test_geometry_is_valid", "test_an_easy_scene_is_placed_right"
GREY = "test_photos_without_texture_raise_a_matching_error"
CASES = {
    "depths of 0": (
        {"spoil": lambda g: replace(g, depths=g.depths * 0)},
        VALID,
        "return depths above 0, got 0",
    ),
    "confidence beyond 1": (
        {"spoil": lambda g: replace(g, confidence=g.confidence * 5)},
        VALID,
        "return confidence in [0, 1]",
    ),
    "world coordinates": ({"spoil": shifted}, VALID, "in the frame of view 0"),
    "view 0 not placed": (
        {"spoil": lambda g: replace(g, registered=torch.zeros_like(g.registered))},
        VALID,
        "place view 0 and another one",
    ),
    "a tuple": (
        {"spoil": lambda g: (g.c2w, g.depths)},
        VALID,
        "interfaces.Geometry, got tuple",
    ),
    "a wrong rotation": ({"spoil": turned}, PLACED, "the rotation is off by"),
    "flat depths": (
        {"spoil": lambda g: replace(g, depths=g.depths * 0 + 1)},
        PLACED,
        "depths are off by",
    ),
    "the wrong side": ({"spoil": mirrored}, PLACED, "stands on the wrong side"),
    "depths in another unit": (
        {"spoil": lambda g: replace(g, depths=3 * g.depths)},
        PLACED,
        "3 times that of the poses",
    ),
    "an invented pose": ({"refuse": None}, GREY, "instead of inventing a pose"),
    "a traceback": (
        {"refuse": ZeroDivisionError},
        GREY,
        "raise edit3r.contract.errors.MatchingError",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_matcher_broken_by(case, complaint):
    changes, claim, advice = CASES[case]
    assert advice in complaint(MatcherContract, lambda: Knowing(**changes), claim)


def test_the_truth_passes():
    contract = type("Bound", (MatcherContract,), {"build": lambda self: Knowing()})()
    for claim in (VALID, PLACED, GREY):
        getattr(contract, claim)()


def test_every_claim_about_matchers_can_fail():
    own = {name for name in vars(MatcherContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
