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
    consistent: np.ndarray  # bool [H, W], source pixels that come back to where they started


def flow_between(source: np.ndarray, target: np.ndarray) -> Flow:
    """Dense flow both ways between two grey uint8 pictures of one size."""
    height, width = source.shape
    if min(height, width) < SMALLEST:
        still = np.zeros((height, width, 2), np.float32)
        return Flow(still, still, np.zeros((height, width), dtype=bool))
    engine = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    engine.setFinestScale(0)
    forward, backward = engine.calc(source, target, None), engine.calc(target, source, None)
    there = _grid(height, width) + forward
    back = cv2.remap(backward, there, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(1e4, 1e4))
    error = np.linalg.norm(forward + back, axis=2)
    return Flow(forward, backward, error < ERROR_FLOOR + ERROR_SLOPE * np.linalg.norm(forward, axis=2))


def warp_by_flow(mask: np.ndarray, flow: Flow) -> tuple[np.ndarray, float]:
    """The source's bool mask on the target's grid, and the share of its pixels whose flow is consistent."""
    height, width = mask.shape
    came_from = _grid(height, width) + flow.backward
    warped = cv2.remap(mask.astype(np.float32), came_from, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return warped > 0.5, float(flow.consistent[mask].mean()) if mask.any() else 0.0


def _grid(height: int, width: int) -> np.ndarray:
    """x and y of every pixel, float32 [H, W, 2]."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), 2).astype(np.float32)
