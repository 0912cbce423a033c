"""Outlines of masks drawn on images, so that one sees what was selected."""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

INSIDE, AROUND = 255, 0
"""A white line in a black one is seen on every photo."""


def outlined(
    image: Float[Tensor, "3 height width"], mask: Float[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """The image with the outline of what is above 0.5 in the mask."""
    pixels = (image.movedim(0, -1).clamp(0, 1) * 255).round().byte().cpu().numpy()
    pixels = np.ascontiguousarray(pixels)
    draw_outline(pixels, (mask > 0.5).cpu().numpy())
    return torch.from_numpy(pixels).movedim(-1, 0).to(image) / 255


def draw_outline(pixels: np.ndarray, inside: np.ndarray) -> None:
    """Draw the outline of a mask of booleans into bytes: [height, width, 3] of RGB, or
    [height, width, 2] of grey and opacity.
    """
    found = inside.astype(np.uint8)
    contours, _ = cv2.findContours(found, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    width = max(1, round(max(inside.shape) / 400))  # [pixels]
    for shade, times in ((AROUND, 3), (INSIDE, 1)):
        colour = (shade, 255) if pixels.shape[-1] == 2 else (shade,) * 3
        cv2.drawContours(pixels, contours, -1, colour, times * width, cv2.LINE_AA)


def outlined_views(
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "view height width"] | None,
) -> Float[Tensor, "view 3 height width"]:
    """The images with the outlines of their masks, where there are any."""
    if masks is None:
        return images
    return torch.stack([outlined(*pair) for pair in zip(images, masks)])
