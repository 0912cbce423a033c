"""Cameras of the matchers: NumPy, float64, intrinsics in pixels of the working image, pixel centres
at +0.5.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from edit3r.contract.types import Views
from edit3r.kit.geometry.cameras import to_pixels


@dataclass(frozen=True)
class CalibratedImage:
    """An image with the intrinsics of its camera."""

    pixels: Float[np.ndarray, "height width 3"]  # sRGB in [0, 1], float32
    K: Float[np.ndarray, "3 3"]  # intrinsics in pixels

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) [pixels]."""
        return self.pixels.shape[:2]

    @property
    def grey(self) -> Float[np.ndarray, "height width"]:
        """Mean of the channels."""
        return self.pixels.mean(axis=2)

    def reduced(self, longest: int) -> "CalibratedImage":
        """The image with a long side of at most `longest` [pixels]."""
        height, width = self.size
        scale = min(1.0, longest / max(height, width))
        if scale == 1.0:
            return self
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        stretch = np.array([[size[0] / width], [size[1] / height], [1.0]])
        return CalibratedImage(
            cv2.resize(self.pixels, size, interpolation=cv2.INTER_AREA),
            self.K * stretch,
        )

    @property
    def fov(self) -> float:
        """Field of view across the longer side [degrees]."""
        return float(np.degrees(2 * np.arctan(0.5 * max(self.size) / self.K[0, 0])))

    def without_pixels(self) -> "CalibratedImage":
        """The image black, in next to no memory: what is kept of it is its size."""
        black = np.broadcast_to(np.float32(0), self.pixels.shape)
        return CalibratedImage(black, self.K)

    def with_fov(self, fov: float) -> "CalibratedImage":
        """The image as if taken with a field of view of `fov` [degrees] across its longer side."""
        intrinsics = self.K.copy()
        intrinsics[0, 0] = intrinsics[1, 1] = (
            0.5 * max(self.size) / np.tan(np.radians(fov) / 2)
        )
        return CalibratedImage(self.pixels, intrinsics)

    def zoomed(self, factor: float) -> "CalibratedImage":
        """The image as if taken with focal lengths `factor` times as long."""
        return CalibratedImage(self.pixels, self.K * np.array([[factor, factor, 1.0]]))


def calibrated_images(views: Views, scene: int) -> list[CalibratedImage]:
    """The views of one scene of the batch."""
    images = views.images[scene].detach().permute(0, 2, 3, 1).cpu().float().numpy()
    intrinsics = to_pixels(
        views.intrinsics[scene].detach().double().cpu(), views.image_size
    ).numpy()
    return [
        CalibratedImage(np.ascontiguousarray(image), matrix)
        for image, matrix in zip(images, intrinsics)
    ]


@dataclass(frozen=True)
class Pose:
    """A rigid motion from one camera's frame to another's: `y = rotation @ x + translation`."""

    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]

    @staticmethod
    def identity() -> "Pose":
        """No motion."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: Float[np.ndarray, "4 4"]) -> "Pose":
        """The motion that a 4x4 matrix is; nothing is inverted."""
        return Pose(matrix[:3, :3], matrix[:3, 3])

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """The 4x4 matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    def inverse(self) -> "Pose":
        """The motion back."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def after(self, first: "Pose") -> "Pose":
        """`first`, then this one."""
        return Pose(
            self.rotation @ first.rotation,
            self.rotation @ first.translation + self.translation,
        )

    def apply(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 3"]:
        """Points of the first frame in the second."""
        return points @ self.rotation.T + self.translation


def cross_matrix(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The matrix `[v]_x` with `[v]_x w = v x w`."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def rays_through(
    points: Float[np.ndarray, "*batch 2"], intrinsics: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "*batch 3"]:
    """Camera-frame vectors with z = 1 through pixel positions (x, y)."""
    homogeneous = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
    return homogeneous @ np.linalg.inv(intrinsics).T


def pixel_rays(
    intrinsics: Float[np.ndarray, "3 3"], size: tuple[int, int]
) -> Float[np.ndarray, "height width 3"]:
    """Camera-frame vectors with z = 1 through the pixel centres of a (height, width)."""
    height, width = size
    grid = np.stack(
        np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1
    )
    return rays_through(grid, intrinsics)


def project(
    points: Float[np.ndarray, "*batch 3"], intrinsics: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "*batch 2"]:
    """Pixel positions (x, y) of camera-frame points; meaningless where z <= 0."""
    image = points @ intrinsics.T
    z = image[..., 2:]
    return image[..., :2] / np.where(np.abs(z) > 1e-12, z, 1e-12)


def triangulate(
    rays_a: Float[np.ndarray, "point 3"],
    rays_b: Float[np.ndarray, "point 3"],
    pose: Pose,
) -> tuple[Float[np.ndarray, "point"], Float[np.ndarray, "point"]]:
    """Camera z along both rays (z = 1) where they come closest; `pose` maps A's frame to B's.

    Least squares of `depth_a R ray_a + t = depth_b ray_b`; nearly parallel rays give huge depths of
    either sign.
    """
    turned = rays_a @ pose.rotation.T
    aa = (turned * turned).sum(1)
    bb = (rays_b * rays_b).sum(1)
    ab = (turned * rays_b).sum(1)
    at, bt = turned @ pose.translation, rays_b @ pose.translation
    determinant = np.maximum(aa * bb - ab * ab, 1e-12)
    return (ab * bt - at * bb) / determinant, (aa * bt - ab * at) / determinant


def parallax_degrees(
    rays_a: Float[np.ndarray, "point 3"],
    rays_b: Float[np.ndarray, "point 3"],
    pose: Pose,
) -> Float[np.ndarray, "point"]:
    """Angle between the two rays of each point [degrees]; `pose` maps A's frame to B's."""
    turned = rays_a @ pose.rotation.T
    across = np.linalg.norm(np.cross(turned, rays_b), axis=1)
    return np.degrees(np.arctan2(across, (turned * rays_b).sum(1)))
