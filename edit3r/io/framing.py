"""Which part of each photo is used, so that photos of any sizes share one, and what that does to the intrinsics."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float64
from PIL import Image
from torch import Tensor


@dataclass(frozen=True)
class Frame:
    """A centred crop of an image and the size it is resampled to."""

    source: tuple[int, int]  # (height, width) of the image [pixels]
    box: tuple[float, float, float, float]  # left, top, right, bottom of the crop [pixels of the image]
    target: tuple[int, int]  # (height, width) after resampling [pixels]

    @property
    def scale(self) -> float:
        """Target pixels per image pixel."""
        left, _, right, _ = self.box
        return self.target[1] / (right - left)

    @property
    def cropped(self) -> float:
        """Share of the image's area that is lost, in [0, 1)."""
        left, top, right, bottom = self.box
        return 1 - (right - left) * (bottom - top) / (self.source[0] * self.source[1])

    def cut(self, image: Image.Image, smooth: Image.Resampling = Image.Resampling.LANCZOS) -> Image.Image:
        """Crop and resample in one step, antialiased, on sRGB values. The image may be of any size of the source's
        shape; a crop that changes nothing returns the very pixels."""
        height, width = self.source
        x, y = image.width / width, image.height / height
        left, top, right, bottom = self.box
        # Rounding must not push the box over the edge.
        box = (left * x, top * y, min(right * x, image.width), min(bottom * y, image.height))
        shrinks = self.target[1] < box[2] - box[0]
        return image.resize(self.target[::-1], smooth if shrinks else Image.Resampling.BICUBIC, box=box)

    def follow(self, intrinsics: Float64[Tensor, "3 3"]) -> Float64[Tensor, "3 3"]:
        """Normalised intrinsics of the crop, from those of the image."""
        height, width = self.source
        left, top, right, bottom = self.box
        stretch = intrinsics.new_tensor([[width / (right - left)], [height / (bottom - top)], [1.0]])
        result = intrinsics * stretch
        result[0, 2] -= left / (right - left)
        result[1, 2] -= top / (bottom - top)
        return result


def common_size(sizes: Sequence[tuple[int, int]], longest: int | None) -> tuple[int, int]:
    """(height, width) that photos of `sizes` are brought to.

    The shape is the median one, so that most photos lose nothing and two different ones meet in the middle; the
    longer side is the (lower) median of what the photos offer in that shape, at most `longest`.
    """
    aspect = math.exp(statistics.median(math.log(width / height) for height, width in sizes))
    offered = [_longer_side(size, aspect) for size in sizes]
    longer = statistics.median_low(offered)
    return _in_shape(aspect, max(1, round(longer if longest is None else min(longer, longest))))


def frame_for(size: tuple[int, int], target: tuple[int, int]) -> Frame:
    """The largest centred part of a photo with the target's shape; all of it where only rounding tells them apart."""
    height, width = size
    if _in_shape(width / height, max(target)) == target:
        return Frame(size, (0.0, 0.0, float(width), float(height)), target)
    scale = max(target[0] / height, target[1] / width)
    used_height, used_width = min(height, target[0] / scale), min(width, target[1] / scale)
    left, top = (width - used_width) / 2, (height - used_height) / 2
    return Frame(size, (left, top, left + used_width, top + used_height), target)


def _in_shape(aspect: float, longer: int) -> tuple[int, int]:
    """(height, width) of `longer` pixels and the shorter side that `aspect` (width / height) gives."""
    shorter = max(1, round(longer * min(aspect, 1 / aspect)))
    return (shorter, longer) if aspect >= 1 else (longer, shorter)


def _longer_side(size: tuple[int, int], aspect: float) -> float:
    height, width = size
    used_width = min(width, height * aspect)
    return max(used_width, used_width / aspect)
