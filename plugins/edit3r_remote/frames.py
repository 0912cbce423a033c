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
from PIL import Image
from torch import Tensor

from edit3r.contract.errors import RunError
from edit3r.kit.geometry.maps import resampled, size_of
from edit3r.kit.photos.decode import FORMATS

# relative difference in width / height up to which an answer is scaled back; no figure kept
SHAPE_TOLERANCE = 0.05
MOST_TIMES = 16  # as many pixels as were asked for that an answer may have


@dataclass(frozen=True)
class ServiceFrame:
    """Where a photo lies inside a service's image; all sizes (height, width) [pixels]."""

    photo: tuple[int, int]
    size: tuple[int, int]  # of the service's image
    inner: tuple[int, int]  # of the scaled photo inside it
    corner: tuple[int, int]  # row, column of the scaled photo's first pixel

    @staticmethod
    def around(
        photo: tuple[int, int], offered: Sequence[tuple[int, int]]
    ) -> "ServiceFrame":
        """Centre the photo in the offered size whose shape is nearest to its own."""
        height, width = photo
        size = min(
            offered, key=lambda size: abs(_log_aspect(size) - _log_aspect(photo))
        )
        scale = min(size[0] / height, size[1] / width)
        inner = (
            min(size[0], max(1, round(height * scale))),
            min(size[1], max(1, round(width * scale))),
        )
        corner = ((size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2)
        return ServiceFrame(photo, size, inner, corner)

    def enclose(
        self, photo: Float[Tensor, "channel h w"]
    ) -> Float[Tensor, "channel height width"]:
        """Scale the photo into the frame and repeat its border."""
        top, left = self.corner
        bottom = self.size[0] - self.inner[0] - top
        right = self.size[1] - self.inner[1] - left
        border = (left, right, top, bottom)
        return F.pad(resampled(photo[None], self.inner), border, mode="replicate")[0]

    def extract(self, image: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 h w"]:
        """Cut the photo's part out of an image of the frame's size, at the photo's size."""
        top, left = self.corner
        height, width = self.inner
        own = image[None, :, top : top + height, left : left + width]
        return resampled(own, self.photo)[0]


def encode_png(image: Float[Tensor, "channel height width"]) -> bytes:
    """Code an RGB or RGBA image in [0, 1] as PNG.

    Paid answers are kept by a hash of these bytes.
    """
    pixels = (image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()
    buffer = io.BytesIO()
    # sent once: speed before size
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1)
    return buffer.getvalue()


def encode_mask(mask: Float[Tensor, "1 height width"]) -> bytes:
    """Code a mask as PNG as a service reads it: transparent where the image may change."""
    return encode_png((mask <= 0).float().expand(4, -1, -1))


def decode(
    content: bytes, size: tuple[int, int], view: str
) -> tuple[Float[Tensor, "3 height width"], str]:
    """Read a service's image at the asked size, and what is to be said about it ('' if nothing).

    Raises RunError for what is no image, or one of another shape.
    """
    pixels = _pixels(content, size, view)
    image = torch.from_numpy(pixels).permute(2, 0, 1).float() / 255
    given = size_of(image)
    if given == size:
        return image, ""
    text = _another_size(given, size, view)
    return resampled(image[None], size)[0], f"{text}; it was scaled."


def _another_size(given: tuple[int, int], size: tuple[int, int], view: str) -> str:
    return f"the answer for {view} is {given[1]}x{given[0]} pixels instead of {size[1]}x{size[0]}"


def _pixels(content: bytes, size: tuple[int, int], view: str) -> np.ndarray:
    """RGB bytes `[height, width, 3]` of a coded image, decoded where it has the shape of `size`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(content), formats=FORMATS)
        given = (image.height, image.width)
        if math.prod(given) <= MOST_TIMES * math.prod(size):
            if abs(_log_aspect(given) - _log_aspect(size)) > SHAPE_TOLERANCE:
                raise RunError(
                    f"{_another_size(given, size, view)}, another shape: its content cannot be put "
                    "back where it was."
                )
            return np.array(image.convert("RGB"))
    except Image.DecompressionBombError:
        pass
    except (OSError, ValueError, SyntaxError):
        start = content[:40].decode("utf-8", "replace")
        raise RunError(
            f"the answer for {view} is not an image ({len(content)} bytes, starting {start!r})."
        ) from None
    raise RunError(f"the answer for {view} has far too many pixels.")


def _log_aspect(size: tuple[int, int]) -> float:
    height, width = size
    return math.log(width / height)
