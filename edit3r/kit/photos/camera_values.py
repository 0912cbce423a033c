"""What files state of a camera, checked: sizes, intrinsics, poses, names of images."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from edit3r.contract.lens import Lens
from edit3r.kit.photos.decode import MAX_JPEG_PIXELS

TOLERANCE = 0.01
"""How far a rotation's products, or a number that must be 0 or 1, may be off: files are rounded."""

MIN_FOCAL = 0.01  # of the longer side
MAX_FOCAL = 1000.0
MAX_POSITION = 1e8  # [the file's unit]: float32 would keep nothing of the rest
MAX_CENTRE = 100.0  # of the principal point [image widths, heights]

Matrix3 = Float64[np.ndarray, "3 3"]
Matrix4 = Float64[np.ndarray, "4 4"]


@dataclass(frozen=True)
class PosedCamera:
    """What a camera file says of one image."""

    file: str  # as written, relative to the camera file's folder
    width: int  # [pixels]
    height: int  # [pixels]
    # [pixels], centre of the top-left pixel at (0.5, 0.5); None: not known
    K: Matrix3 | None
    c2w: Matrix4 | None  # OpenCV axes, the file's own scale; None: not known
    # OpenCV's k1, k2, p1, p2, k3; () for a plain pinhole
    distortion: tuple[float, ...] = ()
    mask: str = ""  # file of a mask of the image, relative to the camera file's folder

    @property
    def intrinsics(self) -> Matrix3 | None:
        """`K` normalised as everywhere inside edit3r: fx, cx in widths, fy, cy in heights."""
        if self.K is None:
            return None
        return self.K / np.array([[self.width], [self.height], [1.0]])

    @property
    def lens(self) -> Lens | None:
        """What bends straight lines in the photo; None for a plain pinhole."""
        if self.intrinsics is None or not self.distortion:
            return None
        (fx, _, cx), (_, fy, cy), _ = self.intrinsics.tolist()
        return Lens((fx, fy), (cx, cy), self.distortion)

    def says_the_same_as(self, other: "PosedCamera") -> bool:
        """Whether both have the same lens and pose."""
        numbers: tuple[tuple[Any, Any], ...] = (
            ((self.width, self.height), (other.width, other.height)),
            (self.K, other.K),
            (self.c2w, other.c2w),
            (self.distortion, other.distortion),
        )
        return all(
            (a is None) == (b is None) and (a is None or np.array_equal(a, b))
            for a, b in numbers
        )


def pose_from_outside(value: Any, name: str) -> Matrix4 | None:
    """Turn what a file says into a pose, a rotation and a position; None stays None.

    3x4 is taken as well. Raises ValueError, saying what is wrong, for anything else, such as a
    matrix that mirrors, scales or flattens the world.
    """
    if value is None:
        return None
    matrix = _numbers(value, name)
    if matrix.shape == (3, 4):
        matrix = np.vstack((matrix, (0.0, 0.0, 0.0, 1.0)))
    require(matrix.shape == (4, 4), f"{name} has shape {matrix.shape}, expected (4, 4)")
    require(
        _near(matrix[3], (0, 0, 0, 1)),
        f"the last row of {name} is {_shown(matrix[3])}, expected 0, 0, 0, 1",
    )
    rotation = matrix[:3, :3]
    lengths = np.hypot.reduce(rotation)
    require(
        lengths.max() < 2 and _near(rotation.T @ rotation, np.eye(3)),
        f"the axes in {name} are no rotation (lengths {_shown(lengths)}), expected length 1 at "
        "right angles",
    )
    require(
        np.linalg.det(rotation) > 0,
        f"{name} mirrors the world, expected a rotation (determinant 1, not -1)",
    )
    position = matrix[:3, 3]
    require(
        np.abs(position).max() <= MAX_POSITION,
        f"the position in {name} is {_shown(position)}, expected at most {MAX_POSITION:g}",
    )
    return matrix


def intrinsics_from_outside(value: Any, width: float, height: float) -> Matrix3 | None:
    """Turn what a file says into intrinsics of an image of that size, in the same unit.

    None stays None. Raises ValueError, saying what is wrong, for anything but `[[fx, 0, cx], [0,
    fy, cy], [0, 0, 1]]`.
    """
    if value is None:
        return None
    matrix = _numbers(value, "K")
    require(matrix.shape == (3, 3), f"K has shape {matrix.shape}, expected (3, 3)")
    focal = matrix.diagonal()[:2]
    shares = focal / max(width, height)
    require(focal.min() > 0, f"focal lengths {_shown(focal)}, expected above 0")
    require(
        shares.min() > MIN_FOCAL and shares.max() < MAX_FOCAL,
        f"focal lengths {_shown(focal)}, expected {MIN_FOCAL:g} to {MAX_FOCAL:g} times the "
        "image's longer side",
    )
    centre = matrix[:2, 2]
    require(
        np.abs(centre / (width, height)).max() <= MAX_CENTRE,
        f"the principal point of K is {_shown(centre)}, far outside of the image",
    )
    skew = (matrix[0, 1] / focal[0], matrix[1, 0] / focal[1])
    require(
        _near(skew, 0) and _near(matrix[2], (0, 0, 1)),
        "K has other numbers where a pinhole has 0, 0, 0, 0 and 1",
    )
    return matrix


def require(holds: Any, problem: str) -> None:
    if not holds:
        raise ValueError(problem)


def _near(values: Any, expected: Any) -> bool:
    return bool(np.abs(np.subtract(values, expected)).max() <= TOLERANCE)


def _numbers(value: Any, name: str) -> Float64[np.ndarray, "*shape"]:
    matrix = np.array(value, dtype=np.float64)
    require(np.isfinite(matrix).all(), f"{name} holds values that are not finite")
    return matrix


def size_from_outside(width: Any, height: Any) -> tuple[int, int]:
    """(width, height) as a file states them; raises ValueError for what is no size of an image."""
    for side in (width, height):
        require(
            not isinstance(side, str | bool) and int(side) == side,
            "width and height must be whole numbers",
        )
    require(
        min(width, height) >= 1 and width * height <= MAX_JPEG_PIXELS,
        f"size {width:g}x{height:g}, expected at least 1x1 and at most {MAX_JPEG_PIXELS // 10**6} "
        "megapixels",
    )
    return int(width), int(height)


_HALF = re.compile(r"[\ud800-\udc7f\udd00-\udfff]")


def file_name(value: Any) -> str:
    """A path of an image as a file states it; raises ValueError for what names no file.

    From U+DC80 to U+DCFF stand the bytes of a name that is no UTF-8 (PEP 383); other halves of a
    character stand for nothing.
    """
    names_a_file = (
        isinstance(value, str)
        and "\0" not in value
        and not _HALF.search(value)
        and Path(value).name not in ("", "..")
        and len(value) <= 4096
    )
    require(names_a_file, f"{str(value)[:60]!r} is no name of an image file")
    return value


def _shown(values: Float64[np.ndarray, "*shape"]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
