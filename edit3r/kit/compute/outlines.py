"""Outlines of masks, soft edges that follow the picture's own, and how far two masks overlap."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float

from edit3r.contract.instructions import Box

Mask = Bool[np.ndarray | torch.Tensor, "height width"]

# how far a soft edge may reach [longer sides of the image]; no figure kept
EDGE_REACH = 0.008
EDGE_EPSILON = 1e-4  # colour variance under which the guided filter smooths


def soft_edged(
    image: Float[torch.Tensor, "3 height width"], inside: np.ndarray
) -> Float[torch.Tensor, "height width"]:
    """`softened` for a picture as a tensor."""
    rgb = image.detach().cpu().float().permute(1, 2, 0).contiguous().numpy()
    return torch.from_numpy(softened(rgb, inside)).to(image)


def softened(
    image: Float[np.ndarray, "height width 3"], mask: np.ndarray
) -> Float[np.ndarray, "height width"]:
    """A soft mask in [0, 1] for an RGB image in [0, 1] from a bool mask of any size.

    Guided filter (He et al. 2013): the soft edge follows the image's own. It overshoots, so it is
    clipped.
    """
    height, width = image.shape[:2]
    enlarged = cv2.resize(
        mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR
    )
    soft = np.zeros((height, width), np.float32)
    if not (enlarged > 0).any():
        return soft
    radius = max(1, round(EDGE_REACH * max(height, width)))
    window = window_around(enlarged > 0, 2 * radius)
    part = np.ascontiguousarray(image[window], dtype=np.float32)
    filtered = cv2.ximgproc.guidedFilter(
        part, np.ascontiguousarray(enlarged[window]), radius, EDGE_EPSILON
    )
    near = distance_to(enlarged[window] > 0) <= radius
    # The filter leaves a veil inside and outside; a steeper ramp clears it and keeps the edge soft.
    soft[window] = np.where(near, np.clip((filtered - 0.5) * 1.5 + 0.5, 0, 1), 0)
    return soft


def distance_to(
    mask: Bool[np.ndarray, "height width"],
) -> Float[np.ndarray, "height width"]:
    """Distance [pixels] of every pixel to the nearest one of a mask; huge where it is empty."""
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)


def box_around(mask: Bool[np.ndarray, "height width"]) -> Box:
    """The box around a mask, of one pixel at least."""
    height, width = mask.shape
    x, y, across, down = cv2.boundingRect(mask.astype(np.uint8))
    return x / width, y / height, max(across, 1) / width, max(down, 1) / height


def window_around(
    mask: Bool[np.ndarray, "height width"], margin: float
) -> tuple[slice, slice]:
    """Rows and columns of the box of a mask that is not empty, `margin` pixels wider on each side
    as far as the image goes.
    """
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    margin = int(np.ceil(margin))
    rows = slice(max(0, y - margin), y + height + margin)
    return rows, slice(max(0, x - margin), x + width + margin)


def overlap(one: Mask, other: Mask) -> float:
    """Intersection over union of two bool masks of one size, arrays or tensors; 0 when both are
    empty.
    """
    union = int((one | other).sum())
    return int((one & other).sum()) / union if union else 0.0
