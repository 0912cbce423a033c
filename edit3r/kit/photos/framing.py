"""Which part of each photo is used, so that photos of any sizes share one.

Also what that does to the intrinsics.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from PIL import Image
from torch import Tensor

from edit3r.contract.lens import Crop, Lens

MIN_SHARE = 0.5  # of a photo's sides that is kept where a lens leaves dark corners


@dataclass(frozen=True)
class Frame:
    """A centred crop of an image and the size it is resampled to."""

    source: tuple[int, int]  # (height, width) of the image [pixels]
    box: Crop  # the part that is used [pixels of the image]
    target: tuple[int, int]  # (height, width) after resampling [pixels]
    lens: Lens | None = None  # straightened before the crop

    @property
    def scale(self) -> float:
        """Target pixels per image pixel."""
        left, _, right, _ = self.box
        return self.target[1] / (right - left)

    @property
    def cropped(self) -> float:
        """Share of the image's area that is lost, in [0, 1)."""
        left, top, right, bottom = self.box
        return 1 - (right - left) * (bottom - top) / math.prod(self.source)

    def cut(
        self, image: Image.Image, smooth: Image.Resampling = Image.Resampling.LANCZOS
    ) -> Image.Image:
        """Crop and resample in one step, antialiased, on sRGB values.

        The image may be of any size of the source's shape. A crop that changes nothing returns the
        very pixels.
        """
        if self.lens is not None:
            image = self.lens.undistorted(image)
        height, width = self.source
        scale_x = image.width / width
        scale_y = image.height / height
        left, top, right, bottom = self.box
        # Rounding must not push the box over the edge.
        box = (
            left * scale_x,
            top * scale_y,
            min(right * scale_x, image.width),
            min(bottom * scale_y, image.height),
        )
        shrinks = self.target[1] < box[2] - box[0]
        resampling = smooth if shrinks else Image.Resampling.BICUBIC
        return image.resize(self.target[::-1], resampling, box=box)

    def through(self, lens: Lens | None) -> "Frame":
        """The frame of a photo that `lens` took.

        It is smaller where the lens did not show the corners, which would be dark.
        """
        if lens is None:
            return replace(self, lens=None)
        low, high = np.array(self.box[:2]), np.array(self.box[2:])
        centre = (low + high) / 2
        half = (high - low) / 2
        sides = np.array(self.source[::-1] * 2)
        for share in np.linspace(1, MIN_SHARE, 101):
            box = np.concatenate((centre - share * half, centre + share * half))
            if lens.covers(tuple(box / sides)):
                return replace(self, box=tuple(box.tolist()), lens=lens)
        return replace(self, lens=lens)

    def follow(self, intrinsics: Float64[Tensor, "3 3"]) -> Float64[Tensor, "3 3"]:
        """Normalised intrinsics of the crop, from those of the image."""
        height, width = self.source
        left, top, right, bottom = self.box
        stretch = [[width / (right - left)], [height / (bottom - top)], [1.0]]
        result = intrinsics * intrinsics.new_tensor(stretch)
        result[0, 2] -= left / (right - left)
        result[1, 2] -= top / (bottom - top)
        return result


def common_size(
    sizes: Sequence[tuple[int, int]], longest: int | None
) -> tuple[int, int]:
    """(height, width) that photos of `sizes` are brought to.

    The shape is the median one, so that most photos lose nothing and two different ones meet in the
    middle; the longer side is the (lower) median of what the photos offer in that shape, at most
    `longest`.
    """
    logs = [math.log(width / height) for height, width in sizes]
    aspect = math.exp(statistics.median(logs))
    longer = statistics.median_low(_longer_side(size, aspect) for size in sizes)
    if longest is not None:
        longer = min(longer, longest)
    return _in_shape(aspect, max(1, round(longer)))


def frame_for(size: tuple[int, int], target: tuple[int, int]) -> Frame:
    """The largest centred part of a photo with the target's shape.

    All of it where only rounding tells the shapes apart.
    """
    height, width = size
    if _in_shape(width / height, max(target)) == target:
        return Frame(size, (0.0, 0.0, float(width), float(height)), target)
    scale = max(target[0] / height, target[1] / width)
    used_height = min(height, target[0] / scale)
    used_width = min(width, target[1] / scale)
    left = (width - used_width) / 2
    top = (height - used_height) / 2
    return Frame(size, (left, top, left + used_width, top + used_height), target)


def _in_shape(aspect: float, longer: int) -> tuple[int, int]:
    """(height, width) with a longer side of `longer` pixels; `aspect` is width / height."""
    shorter = max(1, round(longer * min(aspect, 1 / aspect)))
    return (shorter, longer) if aspect >= 1 else (longer, shorter)


def _longer_side(size: tuple[int, int], aspect: float) -> float:
    """Longer side of the largest part of a photo that has the shape `aspect`."""
    height, width = size
    used_width = min(width, height * aspect)
    return max(used_width, used_width / aspect)
