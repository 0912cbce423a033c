"""Carry a mask along dense optical flow (dense inverse search, Kroeger et al. 2016), checked there and back."""

from dataclasses import dataclass

import cv2
import numpy as np

SMALLEST = 24  # below this side length [pixels] the flow's patches do not fit
ERROR_FLOOR, ERROR_SLOPE = 1.5, 0.05  # allowed forward-backward error: pixels, plus a share of the movement


@dataclass(frozen=True)
class Flow:
    """Movement between a source and a target view."""

    forward: np.ndarray  # float32 [H, W, 2], x and y from source to target [pixels], on the source's grid
    backward: np.ndarray  # float32 [H, W, 2], from target to source, on the target's grid
    leaves: np.ndarray  # bool [H, W], source pixels that come back to where they started
    arrives: np.ndarray  # bool [H, W], the same for the target's pixels


def flow_between(source: np.ndarray, target: np.ndarray) -> Flow:
    """Dense flow both ways between two grey uint8 pictures of one size."""
    height, width = source.shape
    if min(height, width) < SMALLEST:
        still = np.zeros((height, width, 2), np.float32)
        nowhere = np.zeros((height, width), dtype=bool)
        return Flow(still, still, nowhere, nowhere)
    engine = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    engine.setFinestScale(0)
    forward, backward = engine.calc(source, target, None), engine.calc(target, source, None)
    return Flow(forward, backward, _returns(forward, backward), _returns(backward, forward))


@dataclass(frozen=True)
class Carried:
    """A mask carried to another view."""

    mask: np.ndarray  # bool [H, W]
    sure: np.ndarray  # bool [H, W], the part of it that leads back to where it came from
    consistent: float  # share of the source's mask that arrives somewhere and leads back, in [0, 1]


def carry(mask: np.ndarray, flow: Flow) -> Carried:
    """The source's bool mask on the target's grid."""
    height, width = mask.shape
    came_from = _grid(height, width) + flow.backward
    warped = cv2.remap(mask.astype(np.float32), came_from, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT) > 0.5
    return Carried(warped, warped & flow.arrives, float(flow.leaves[mask].mean()) if mask.any() else 0.0)


def _returns(there: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Which pixels end up where they started when they follow `there`, then `back`."""
    height, width = there.shape[:2]
    landed = _grid(height, width) + there
    returned = cv2.remap(back, landed, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(1e4, 1e4))
    error = np.linalg.norm(there + returned, axis=2)
    return error < ERROR_FLOOR + ERROR_SLOPE * np.linalg.norm(there, axis=2)


def _grid(height: int, width: int) -> np.ndarray:
    """x and y of every pixel, float32 [H, W, 2]."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), 2).astype(np.float32)
