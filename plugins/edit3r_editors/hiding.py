"""What a look that hides leaves of a region: a few mean colours, from which nothing comes back.

A blur with a fixed kernel can be undone as long as it is known. So both looks begin with the means
of a few blocks; they differ in how these are drawn.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

Images = Float[Tensor, "view 3 height width"]
Where = Bool[Tensor, "view height width"]

VALUES = 64
"""Mean colours that are left of a piece in all photos together, at most; by eye. Photos of one face
add up, so many of them get larger blocks."""
LEAST = 8
"""Longer side of a block, at least [pixels]: means of fewer pixels would be the pixels."""


def pixelated(images: Images, where: Where) -> Images:
    return _hidden(images, where, cv2.INTER_NEAREST)


def blurred(images: Images, where: Where) -> Images:
    return _hidden(images, where, cv2.INTER_CUBIC)


def _hidden(images: Images, where: Where, between: int) -> Images:
    """The images with each connected piece of `where` drawn from the means of its blocks."""
    across = max(1, int((VALUES / len(images)) ** 0.5))
    pictures = images.permute(0, 2, 3, 1).numpy(force=True).copy()
    for picture, region in zip(pictures, where.numpy(force=True)):
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(
            region.astype(np.uint8)
        )
        for label in range(1, count):
            left, top, width, height, _ = boxes[label]
            place = slice(top, top + height), slice(left, left + width)
            piece = labels[place] == label
            picture[place][piece] = _drawn(picture[place], piece, across, between)
    return torch.from_numpy(pictures).permute(0, 3, 1, 2).to(images)


def _drawn(
    picture: Float[np.ndarray, "height width 3"],
    piece: Bool[np.ndarray, "height width"],
    across: int,
    between: int,
) -> Float[np.ndarray, "pixel 3"]:
    """The pixels of a piece, from means of blocks, at most `across` along its longer side."""
    height, width = piece.shape
    side = max(height, width) / min(across, max(1, max(height, width) // LEAST))
    size = max(1, round(width / side)), max(1, round(height / side))
    # A block that the piece hardly reaches has the mean of all: else it could be a single pixel.
    filled = np.where(piece[..., None], picture, picture[piece].mean(0))
    blocks = cv2.resize(filled, size, interpolation=cv2.INTER_AREA)
    drawn = cv2.resize(blocks, (width, height), interpolation=between)
    return drawn.reshape(height, width, 3).clip(0, 1)[piece]
