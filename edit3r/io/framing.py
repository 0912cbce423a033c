"""Which part of each photo is used, so that photos of any sizes share one, and what that does to
the intrinsics.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64
from PIL import Image
from torch import Tensor

from edit3r.errors import InputError

MOST_DISTORTION = 100.0
MOST_SIDE = 32766  # of a picture that OpenCV remaps [pixels]


@dataclass(frozen=True)
class Lens:
    """A lens that bends straight lines, in OpenCV's model; shares of the photo's width and
    height.
    """

    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, ...]  # k1, k2, p1, p2, k3

    def __post_init__(self) -> None:
        if not all(abs(value) <= MOST_DISTORTION for value in self.distortion):
            raise ValueError(
                f"lens distortion {self.distortion}, expected at most {MOST_DISTORTION:g}"
            )
        if not (
            all(map(math.isfinite, (*self.focal, *self.centre))) and min(self.focal) > 0
        ):
            raise ValueError(
                f"focal lengths {self.focal} and centre {self.centre}, expected finite numbers "
                "above 0"
            )

    def straightened(self, image: Image.Image) -> Image.Image:
        """The image (of any size of the photo's shape) as a plain pinhole would have taken it."""
        if max(image.size) > MOST_SIDE:
            raise InputError(
                f"a photo of {image.width}x{image.height} pixels cannot be straightened; make it "
                "smaller."
            )
        return Image.fromarray(
            cv2.undistort(
                np.asarray(image), self._matrix(image.size), np.array(self.distortion)
            )
        )

    def straightened_place(self, x: float, y: float) -> tuple[float, float]:
        """Where a place on the photo lies on the straightened one; both in shares of the sides."""
        matrix = self._matrix((1, 1)) + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        place = cv2.undistortPoints(
            np.array([[[x, y]]]), matrix, np.array(self.distortion), P=matrix
        )
        return float(place[0, 0, 0]), float(place[0, 0, 1])

    def is_shown(self, box: tuple[float, float, float, float]) -> bool:
        """Whether the photo shows all of a box (left, top, right, bottom; shares) of the
        straightened one.
        """
        x, y = (np.linspace(low, high, 65) for low, high in zip(box[:2], box[2:]))
        sides = [
            (x, np.full(65, y[0])),
            (x, np.full(65, y[-1])),
            (np.full(65, x[0]), y),
            (np.full(65, x[-1]), y),
        ]
        rays = (np.concatenate(sides, 1).T - self.centre) / self.focal
        points = np.concatenate((rays, np.ones((len(rays), 1))), 1)
        matrix = self._matrix((1, 1)) + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        places = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), matrix, np.array(self.distortion)
        )[0]
        return bool((np.abs(places - 0.5) <= 0.5 + 1e-9).all())

    def _matrix(self, size: tuple[int, int]) -> np.ndarray:
        """Intrinsics [pixels] of an image of (width, height) in OpenCV's way, which counts from
        pixel centres.
        """
        (fx, fy), (cx, cy), (width, height) = self.focal, self.centre, size
        return np.array(
            [
                [fx * width, 0, cx * width - 0.5],
                [0, fy * height, cy * height - 0.5],
                [0, 0, 1],
            ]
        )


@dataclass(frozen=True)
class Frame:
    """A centred crop of an image and the size it is resampled to."""

    source: tuple[int, int]  # (height, width) of the image [pixels]
    box: tuple[
        float, float, float, float
    ]  # left, top, right, bottom of the crop [pixels of the image]
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
        return 1 - (right - left) * (bottom - top) / (self.source[0] * self.source[1])

    def cut(
        self, image: Image.Image, smooth: Image.Resampling = Image.Resampling.LANCZOS
    ) -> Image.Image:
        """Crop and resample in one step, antialiased, on sRGB values. The image may be of any size
        of the source's shape; a crop that changes nothing returns the very pixels.
        """
        image = image if self.lens is None else self.lens.straightened(image)
        height, width = self.source
        x, y = image.width / width, image.height / height
        left, top, right, bottom = self.box
        # Rounding must not push the box over the edge.
        box = (
            left * x,
            top * y,
            min(right * x, image.width),
            min(bottom * y, image.height),
        )
        shrinks = self.target[1] < box[2] - box[0]
        return image.resize(
            self.target[::-1], smooth if shrinks else Image.Resampling.BICUBIC, box=box
        )

    def through(self, lens: Lens | None) -> "Frame":
        """The frame of a photo that `lens` took: smaller where corners would be dark that the lens
        did not show.
        """
        centre, half = (
            np.add(self.box[:2], self.box[2:]) / 2,
            np.subtract(self.box[2:], self.box[:2]) / 2,
        )
        sides = np.array(self.source[::-1] * 2)
        boxes = (
            np.concatenate((centre - share * half, centre + share * half))
            for share in np.linspace(1, 0.5, 101)
        )
        shown = (
            box for box in boxes if lens is None or lens.is_shown(tuple(box / sides))
        )
        return replace(
            self, box=tuple(next(shown, np.array(self.box)).tolist()), lens=lens
        )

    def follow(self, intrinsics: Float64[Tensor, "3 3"]) -> Float64[Tensor, "3 3"]:
        """Normalised intrinsics of the crop, from those of the image."""
        height, width = self.source
        left, top, right, bottom = self.box
        stretch = intrinsics.new_tensor(
            [[width / (right - left)], [height / (bottom - top)], [1.0]]
        )
        result = intrinsics * stretch
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
    aspect = math.exp(
        statistics.median(math.log(width / height) for height, width in sizes)
    )
    offered = [_longer_side(size, aspect) for size in sizes]
    longer = statistics.median_low(offered)
    return _in_shape(
        aspect, max(1, round(longer if longest is None else min(longer, longest)))
    )


def frame_for(size: tuple[int, int], target: tuple[int, int]) -> Frame:
    """The largest centred part of a photo with the target's shape; all of it where only rounding
    tells them apart.
    """
    height, width = size
    if _in_shape(width / height, max(target)) == target:
        return Frame(size, (0.0, 0.0, float(width), float(height)), target)
    scale = max(target[0] / height, target[1] / width)
    used_height, used_width = (
        min(height, target[0] / scale),
        min(width, target[1] / scale),
    )
    left, top = (width - used_width) / 2, (height - used_height) / 2
    return Frame(size, (left, top, left + used_width, top + used_height), target)


def _in_shape(aspect: float, longer: int) -> tuple[int, int]:
    """(height, width) of `longer` pixels and the shorter side that `aspect` (width / height)
    gives.
    """
    shorter = max(1, round(longer * min(aspect, 1 / aspect)))
    return (shorter, longer) if aspect >= 1 else (longer, shorter)


def _longer_side(size: tuple[int, int], aspect: float) -> float:
    height, width = size
    used_width = min(width, height * aspect)
    return max(used_width, used_width / aspect)
