"""Which way is up in a scene, from how people hold a camera."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

__all__ = ["quarter_turns", "up_direction"]

TRUST_IN_MEAN = 0.03
"""How much the mean of the cameras' own ups counts beside their horizons. Chosen on sets of seven
scenes (docs/notes/scenes.md); it decides alone where all cameras face the same way."""


def quarter_turns(c2w: Float[Tensor, "view 4 4"]) -> Int[Tensor, "view"]:
    """Quarter turns, 0 to 3 anticlockwise, that bring each image the way round of most others."""
    ups = _ups_of_turned(c2w)
    agree = (ups[:, 0] @ ups[:, 0].T) > math.cos(math.radians(45))
    most = ups[agree.sum(1).argmax(), 0]
    return (ups @ most).argmax(1)


def up_direction(c2w: Float[Tensor, "view 4 4"]) -> Float[Tensor, "3"]:
    """The unit vector that points up, in the frame of the poses.

    People tilt a camera up and down but seldom to its side, so up is across the x axes of all
    images (Brown and Lowe, Automatic Panoramic Image Stitching, IJCV 2007, section 5). One image
    that was turned by a quarter does not tilt the scene.
    """
    views = torch.arange(len(c2w), device=c2w.device)
    turns = quarter_turns(c2w)
    ups = _ups_of_turned(c2w)[views, turns]
    across = torch.linalg.cross(ups, c2w[:, :3, 2])
    mean = torch.nn.functional.normalize(ups.mean(0), dim=0)
    spread = across.T @ across / len(c2w) - TRUST_IN_MEAN * torch.outer(mean, mean)
    up = torch.linalg.eigh(spread).eigenvectors[:, 0]
    return up if up @ mean > 0 else -up


def _ups_of_turned(c2w: Float[Tensor, "view 4 4"]) -> Float[Tensor, "view 4 3"]:
    """What is up in the scene once an image was turned by 0, 1, 2 and 3 quarters anticlockwise."""
    x, y = c2w[:, :3, 0], c2w[:, :3, 1]
    return torch.stack((-y, x, y, -x), 1)
