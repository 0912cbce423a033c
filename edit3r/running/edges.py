"""Steps of depth moved onto the outline of what was selected.

Measured depth ends a few pixels beside the thing that it belongs to. From the photos nobody sees
that; between them paint flies beside the thing, or the wall behind shows through it.
"""

from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.warping import warp

__all__ = ["edges_on_outlines"]

BAND = 0.02  # how far beside an outline depth may be wrong [long sides]
STEP = 0.05  # relative difference in depth by which a thing stands before what is behind it
FAR = 3  # how far the nearest depth of a side may lie [bands]

Map = Float[np.ndarray, "height width"]


def edges_on_outlines(
    gaussians: Gaussians,
    cameras: Cameras,
    depths: Float[Tensor, "batch view height width"],
    masks: Float[Tensor, "batch view height width"],
) -> Gaussians:
    """The Gaussians with those moved along their photo's rays that lie beside an outline, at the
    depth of its other side. `depths` and `masks` are those of the cameras' photos.
    """
    means, scales = gaussians.means.clone(), gaussians.scales.clone()
    for scene, view in np.ndindex(*masks.shape[:2]):
        own = gaussians.view_index == view
        factor = _factors(
            depths[scene, view].numpy(force=True),
            (masks[scene, view] > 0.5).numpy(force=True),
        )
        pose, lens = cameras.c2w[scene, view], cameras.intrinsics[scene, view]
        pixels, _ = project(means[scene, own], lens, pose)
        moved = torch.from_numpy(factor).to(means)[None]
        moved = warp(moved, pixels[None], "nearest")[0, 0, :, None]
        place = pose[:3, 3]
        means[scene, own] = place + (means[scene, own] - place) * moved
        scales[scene, own] *= moved
    return replace(gaussians, means=means, scales=scales)


def _factors(depth: Map, inside: Bool[np.ndarray, "height width"]) -> Map:
    """What each pixel's depth is to be multiplied by: 1 but where a thing stands a step before what
    is behind it, and a pixel near its outline has the depth of the other side.
    """
    reach = max(2, round(BAND * max(depth.shape)))
    thing, behind = (_nearest(depth, side, reach) for side in (inside, ~inside))
    own, other = np.where(inside, (thing, behind), (behind, thing))
    # where a side is too far away its depth is no number, and nothing is compared with it
    before = np.log(behind / thing) > STEP
    wrong = np.abs(np.log(depth / own)) > np.abs(np.log(depth / other))
    return np.where(before & wrong, own / depth, 1).astype(np.float32)


def _nearest(depth: Map, side: Bool[np.ndarray, "height width"], reach: int) -> Map:
    """At each pixel the nearest depth that surely is of one side of the outline; no number where
    that is far.
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    sure = cv2.erode(side.astype(np.uint8), disc)
    away, labels = cv2.distanceTransformWithLabels(
        1 - sure, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known = np.full(labels.max() + 1, np.nan)
    known[labels[sure > 0]] = depth[sure > 0]
    return np.where(away <= FAR * reach, known[labels], np.nan)
