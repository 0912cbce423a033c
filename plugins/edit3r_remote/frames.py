"""Fit photos of any shape into the few sizes a service offers, and take the photo's part out of its
answer.

A photo is scaled to fit inside the service's frame and its border pixels are repeated up to the
edges: nothing is stretched, so what comes back lies where it was.
"""

import io
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from edit3r.errors import RunError
from edit3r.io.decode import FORMATS, MAX_PIXELS

# relative difference in width / height up to which an answer of another size is scaled back
SHAPE_TOLERANCE = 0.05


@dataclass(frozen=True)
class Frame:
    """Where a photo lies inside a service's image; all sizes (height, width) [pixels]."""

    photo: tuple[int, int]
    size: tuple[int, int]  # of the service's image
    inner: tuple[int, int]  # of the scaled photo inside it
    corner: tuple[int, int]  # row, column of the scaled photo's first pixel

    @staticmethod
    def around(photo: tuple[int, int], offered: Sequence[tuple[int, int]]) -> "Frame":
        """Take the offered size whose shape is nearest to the photo's, and centre the photo in
        it.
        """
        aspect = math.log(photo[1] / photo[0])
        size = min(offered, key=lambda s: abs(math.log(s[1] / s[0]) - aspect))
        scale = min(size[0] / photo[0], size[1] / photo[1])
        inner = tuple(
            min(full, max(1, round(side * scale))) for side, full in zip(photo, size)
        )
        corner = tuple((full - side) // 2 for side, full in zip(inner, size))
        return Frame(photo, size, inner, corner)

    def enclose(
        self, photo: Float[Tensor, "channel h w"]
    ) -> Float[Tensor, "channel height width"]:
        """Scale the photo into the frame and repeat its border."""
        scaled = _resize(photo, self.inner)
        top, left = self.corner
        bottom, right = (
            self.size[0] - self.inner[0] - top,
            self.size[1] - self.inner[1] - left,
        )
        return F.pad(scaled[None], (left, right, top, bottom), mode="replicate")[0]

    def extract(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 h w"]:
        """Cut the photo's part out of an image of the frame's size, at the photo's size."""
        top, left = self.corner
        return _resize(
            image[:, top : top + self.inner[0], left : left + self.inner[1]], self.photo
        )


def encode_png(image: Float[Tensor, "channel height width"]) -> bytes:
    """Code an RGB or RGBA image in [0, 1] as PNG; paid answers are kept by a hash of these
    bytes.
    """
    pixels = (
        (image.detach().cpu().float().clamp(0, 1) * 255)
        .round()
        .byte()
        .permute(1, 2, 0)
        .numpy()
    )
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(
        buffer, format="PNG", compress_level=1
    )  # sent once: speed before size
    return buffer.getvalue()


def encode_mask(mask: Float[Tensor, "height width"]) -> bytes:
    """Code a mask as PNG as a service reads it: transparent where the image may change."""
    keep = (mask <= 0).to(torch.float32)
    return encode_png(torch.stack((keep, keep, keep, keep)))


def decode(
    content: bytes, size: tuple[int, int], view: str
) -> tuple[Float[Tensor, "3 height width"], str]:
    """Read a service's image at the asked size, and what is to be said about it ('' if nothing).

    Raises RunError for what is no image, or one of another shape.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", Image.DecompressionBombWarning
            )  # said below, before decoding
            with Image.open(io.BytesIO(content), formats=FORMATS) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise RunError(
                        f"the answer for {view} is {image.width}x{image.height} pixels, far too "
                        "many."
                    )
                pixels = np.array(image.convert("RGB"))
    except Image.DecompressionBombError:
        raise RunError(f"the answer for {view} has far too many pixels.") from None
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError):
        start = content[:40].decode("utf-8", "replace")
        raise RunError(
            f"the answer for {view} is no picture ({len(content)} bytes, starting {start!r})."
        ) from None
    tensor = torch.from_numpy(pixels).permute(2, 0, 1).float() / 255
    given = tuple(tensor.shape[1:])
    if given == size:
        return tensor, ""
    text = f"the answer for {view} is {given[1]}x{given[0]} pixels instead of {size[1]}x{size[0]}"
    if abs(math.log((given[1] * size[0]) / (given[0] * size[1]))) > SHAPE_TOLERANCE:
        raise RunError(
            f"{text}, another shape: its content cannot be put back where it was."
        )
    return _resize(tensor, size), f"{text}; it was scaled."


def _resize(
    image: Float[Tensor, "channel h w"], size: tuple[int, int]
) -> Float[Tensor, "channel height width"]:
    if tuple(image.shape[1:]) == size:
        return image
    scaled = F.interpolate(
        image[None], size, mode="bicubic", antialias=True, align_corners=False
    )
    return scaled[0].clamp(0, 1)
