"""Cameras that no photo has are refused by every rasterizer, as by a run."""

import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras
from edit3r_testing.scenes import balls

SCENE = balls(torch.tensor([[[0.0, 0, 4]]]), size=0.2)


def cameras(*changes):
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    pose = torch.eye(4)
    for matrix, place, value in changes:
        {"lens": lens, "pose": pose}[matrix][place] = value
    return Cameras(pose[None, None], lens[None, None], (16, 16))


WRONG = {
    "skew": [("lens", (0, 1), 0.2)],
    "skew below": [("lens", (1, 0), 0.2)],
    "last row of the lens": [("lens", (2, 2), 2.0)],
    "projective lens": [("lens", (2, 0), 0.1)],
    "last row of the pose": [("pose", (3, 3), 0.5)],
    "projective pose": [("pose", (3, 0), 0.1)],
    "stretched": [("pose", (0, 0), 1.5)],
    "flat": [("pose", (2, 2), 0.0)],
    "leaning": [("pose", (0, 1), 0.3)],
    "not a number": [("pose", (0, 0), float("nan"))],
}


@pytest.mark.parametrize("name", ["torch", "numba"])
@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG)
def test_a_camera_that_is_none_is_refused(name, changes):
    with pytest.raises(InputError, match="expected a pinhole camera"):
        edit3r.build("rasterizer", name).render(SCENE, cameras(*changes))


@pytest.mark.parametrize("name", ["torch", "numba"])
def test_rounded_ones_are_drawn(name):
    rounded = cameras(
        ("pose", (0, 0), 0.9999), ("lens", (0, 1), 1e-5), ("lens", (0, 2), 0.3)
    )
    assert edit3r.build("rasterizer", name).render(SCENE, rounded).alphas.sum() > 0
