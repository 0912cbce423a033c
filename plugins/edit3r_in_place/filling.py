"""What only a removed thing hid, continued from around it; a guess."""

from dataclasses import replace

import cv2
import numpy as np
import torch
from edit3r_objects.api import patch
from jaxtyping import Bool
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Gaussians, GivenScene

OPEN = 0.7  # by eye: alpha below which a pixel shows no surface


def filled(
    scene: GivenScene, rest: Gaussians, rasterizer: Rasterizer
) -> Gaussians | None:
    """New Gaussians that close what is open in the `rest` of a scene (batch 1); None for none.

    Closed is what lies within surfaces on all sides, as a place on a wall; where the scene ends,
    nothing was hidden. View after view, each closes what those before it left open.
    """
    whole, found = rest, []
    for view in range(scene.cameras.count):
        camera = scene.cameras.select([view])
        left = rasterizer.render(whole, camera).alphas[0, 0, 0] < OPEN
        hole = _enclosed(left, scene.alphas[0, view] < OPEN)
        if not bool(hole.any()):
            continue
        closing = patch(whole, hole, camera, rasterizer)
        index = torch.full_like(closing.view_index, view)
        found.append(replace(closing, view_index=index))
        whole = Gaussians.cat([whole, found[-1]])
    return Gaussians.cat(found) if found else None


def _enclosed(
    left: Bool[Tensor, "height width"], before: Bool[Tensor, "height width"]
) -> Bool[Tensor, "height width"]:
    """The pieces of what is open that touch nothing that was open before, nor the border."""
    _, pieces = cv2.connectedComponents(left.numpy().astype(np.uint8))
    border = np.concatenate((pieces[[0, -1]].ravel(), pieces[:, [0, -1]].ravel()))
    outer = np.union1d(np.unique(pieces[before.numpy()]), np.unique(border))
    return left & torch.from_numpy(~np.isin(pieces, outer))
