"""Outlines of masks drawn on images, so that one sees what was selected."""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

INSIDE, AROUND = (255, 255, 255), (0, 0, 0)
"""A white line in a black one is seen on every photo [RGB]."""


def outlined(
    image: Float[Tensor, "3 height width"], mask: Float[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """The image with the outline of what is above 0.5 in the mask."""
    pixels = (image.movedim(0, -1).clamp(0, 1) * 255).round().byte().cpu().numpy()
    pixels = np.ascontiguousarray(pixels)
    inside = (mask > 0.5).cpu().numpy().astype(np.uint8)
    contours, _ = cv2.findContours(inside, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    width = max(1, round(max(inside.shape) / 400))  # [pixels]
    cv2.drawContours(pixels, contours, -1, AROUND, 3 * width, cv2.LINE_AA)
    cv2.drawContours(pixels, contours, -1, INSIDE, width, cv2.LINE_AA)
    return torch.from_numpy(pixels).movedim(-1, 0).to(image) / 255


def outlined_views(
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "view height width"] | None,
) -> Float[Tensor, "view 3 height width"]:
    """The images with the outlines of their masks, where there are any."""
    if masks is None:
        return images
    return torch.stack([outlined(*pair) for pair in zip(images, masks)])
