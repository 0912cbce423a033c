"""The distortion of a lens (OpenCV's model), and photos without it."""

from dataclasses import dataclass

import cv2
import numpy as np
from PIL import Image

from edit3r.contract.errors import InputError

MAX_DISTORTION = 100.0  # a sanity limit
MAX_SIDE = 32766  # of an image that OpenCV remaps [pixels]
BORDER_SAMPLES = 65  # places on each side of a crop

Crop = tuple[float, float, float, float]
"""Left, top, right, bottom. (Boxes of selections are x, y, width, height.)"""


@dataclass(frozen=True)
class Lens:
    """A lens that bends straight lines, in OpenCV's model; shares of the photo's sides."""

    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, ...]  # k1, k2, p1, p2, k3; as many as are known

    def __post_init__(self) -> None:
        if not all(abs(value) <= MAX_DISTORTION for value in self.distortion):
            raise ValueError(
                f"lens distortion {self.distortion}, expected at most {MAX_DISTORTION:g}"
            )
        if not np.isfinite(self.focal + self.centre).all() or min(self.focal) <= 0:
            raise ValueError(
                f"focal lengths {self.focal} and centre {self.centre}, expected finite numbers "
                "above 0"
            )

    def undistorted(self, image: Image.Image) -> Image.Image:
        """The image (of any size of the photo's shape) as a plain pinhole would have taken it."""
        width, height = image.size
        if max(image.size) > MAX_SIDE:
            raise InputError(
                f"a photo of {width}x{height} pixels cannot be undistorted; make it smaller."
            )
        stretch = np.array([[width], [height], [1.0]])
        matrix = self._matrix() * stretch
        matrix[:2, 2] -= 0.5  # OpenCV counts from the centre of the first pixel
        pixels = cv2.undistort(np.asarray(image), matrix, self._numbers())
        return Image.fromarray(pixels)

    def undistorted_place(self, x: float, y: float) -> tuple[float, float]:
        """Where a place on the photo lies on the straightened one; both in shares of the sides."""
        matrix = self._matrix()
        place = cv2.undistortPoints(
            np.array([[[x, y]]]), matrix, self._numbers(), P=matrix
        )
        return float(place[0, 0, 0]), float(place[0, 0, 1])

    def covers(self, crop: Crop) -> bool:
        """Whether a crop of the straightened photo [shares of its sides] lies within what the photo
        shows: straightening leaves corners dark that the lens did not take.
        """
        corner, opposite = np.array(crop[:2]), np.array(crop[2:])
        along = np.linspace(0, 1, BORDER_SAMPLES)
        x, y = np.meshgrid(along, along)
        on_border = (x % 1 == 0) | (y % 1 == 0)
        border = np.stack((x[on_border], y[on_border]), 1)
        rays = (corner + border * (opposite - corner) - self.centre) / self.focal
        points = np.pad(rays, ((0, 0), (0, 1)), constant_values=1.0)
        places, _ = cv2.projectPoints(
            points, np.zeros(3), np.zeros(3), self._matrix(), self._numbers()
        )
        return bool((np.abs(places - 0.5) <= 0.5 + 1e-9).all())

    def _numbers(self) -> np.ndarray:
        """The distortion; OpenCV takes four numbers at least, and COLMAP's default has one."""
        return np.pad(self.distortion, (0, max(0, 4 - len(self.distortion))))

    def _matrix(self) -> np.ndarray:
        """Intrinsics of a photo whose sides are 1."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
