"""Pictures of previews: photos, outlines and what lies over a photo, as JPEG and PNG."""

import io

import cv2
import numpy as np
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r.kit.contact_sheet import draw_outline, outlined
from edit3r.kit.photos.images import to_bytes
from edit3r_app.draft import Mark

# The numbers of this block: no figures kept.
DIMMED = 0.55
"""Brightness of what is not selected."""
DRAWN = 1024
"""Longer side at least, about, of what is drawn over photos [pixels]."""
BLUR = 0.7  # of steps along its border; a line of one pixel stays [pixels]
THUMBNAIL = 240  # [pixels], longer side of the picture of a candidate
FINE = 0.004  # how far the border of a candidate may be simplified [longer sides]


def picture(image: Float[Tensor, "3 height width"], mask: Tensor) -> bytes:
    """JPEG of a photo with one thing outlined and the rest darker."""
    dimmed = image * (DIMMED + (1 - DIMMED) * mask)
    return jpeg(outlined(dimmed, mask), THUMBNAIL)


def around(mask: Float[Tensor, "height width"], photo: str) -> Mark:
    """A lasso around the largest piece of a mask."""
    shape = (mask > 0.5).numpy(force=True).astype(np.uint8)
    pieces, _ = cv2.findContours(shape, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(pieces, key=cv2.contourArea)
    line = cv2.approxPolyDP(largest, FINE * max(mask.shape), True)[:, 0]
    height, width = mask.shape
    places = [(float(x / width), float(y / height)) for x, y in line]
    return Mark("lasso", photo, places)


def jpeg(image: Float[Tensor, "3 height width"], most: int = 0) -> bytes:
    content = io.BytesIO()
    made = Image.fromarray(to_bytes(image))
    if most:
        made.thumbnail((most, most))
    made.save(content, "JPEG", quality=88)
    return content.getvalue()


def over(mask: Float[Tensor, "height width"] | None, line: bool = False) -> bytes:
    """PNG that darkens what is not in a mask and outlines what is; clear without one."""
    content = io.BytesIO()
    if mask is None:
        Image.new("LA", (1, 1)).save(content, "PNG")
        return content.getvalue()
    drawn = _enlarged(mask)
    pixels = np.zeros((*drawn.shape, 2), np.uint8)  # grey and opacity
    if not line:
        pixels[..., 1] = np.rint(255 * (1 - DIMMED) * (1 - drawn))
    draw_outline(pixels, drawn > 0.5)
    Image.fromarray(pixels).save(content, "PNG", compress_level=1)
    return content.getvalue()


def _enlarged(mask: Float[Tensor, "height width"]) -> np.ndarray:
    """The mask with smooth borders, large enough for a thin line on a window."""
    small = mask.float().cpu().numpy()
    factor = max(1, round(DRAWN / max(small.shape)))
    if factor == 1:
        return small
    smooth = cv2.GaussianBlur(small, (0, 0), BLUR)
    wanted = tuple(factor * size for size in small.shape[::-1])
    enlarged = cv2.resize(smooth, wanted, interpolation=cv2.INTER_CUBIC)
    return np.clip(factor * (enlarged - 0.5) + 0.5, 0, 1)
