"""Cameras of the matcher: NumPy, float64, intrinsics in pixels of the working picture, pixel centres at +0.5."""

from dataclasses import dataclass

import numpy as np

__all__ = ["Picture", "Pose", "cross_matrix", "pixel_rays", "project", "rays_through"]


@dataclass(frozen=True)
class Picture:
    """A photo at the size the matcher works at."""

    image: np.ndarray  # [height, width, 3] sRGB in [0, 1], float32
    intrinsics: np.ndarray  # [3, 3] in pixels

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) [pixels]."""
        return self.image.shape[:2]

    @property
    def grey(self) -> np.ndarray:
        """Mean of the channels, `[height, width]`."""
        return self.image.mean(axis=2)


@dataclass(frozen=True)
class Pose:
    """A rigid motion from one camera's frame to another's: `y = rotation @ x + translation`."""

    rotation: np.ndarray  # [3, 3]
    translation: np.ndarray  # [3]

    @staticmethod
    def identity() -> "Pose":
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: np.ndarray) -> "Pose":
        return Pose(matrix[:3, :3], matrix[:3, 3])

    @property
    def matrix(self) -> np.ndarray:
        """The 4x4 matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    def inverse(self) -> "Pose":
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def after(self, first: "Pose") -> "Pose":
        """`first`, then this one."""
        return Pose(self.rotation @ first.rotation, self.rotation @ first.translation + self.translation)

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Move points `[..., 3]`."""
        return points @ self.rotation.T + self.translation


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """The matrix `[v]_x` with `[v]_x w = v x w`."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def rays_through(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Camera-frame vectors with z = 1 through pixel positions `[..., 2]`."""
    homogeneous = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    return homogeneous @ np.linalg.inv(intrinsics).T


def pixel_rays(intrinsics: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Camera-frame vectors with z = 1 through every pixel centre, `[height, width, 3]`."""
    height, width = size
    grid = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    return rays_through(grid, intrinsics)


def project(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Pixel positions `[..., 2]` of camera-frame points; meaningless where z <= 0."""
    image = points @ intrinsics.T
    z = image[..., 2:]
    return image[..., :2] / np.where(np.abs(z) > 1e-12, z, 1e-12)
