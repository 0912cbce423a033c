"""Depths of a point seen along two rays."""

import numpy as np

from edit3r_matching.camera import Pose

__all__ = ["parallax_degrees", "triangulate"]


def triangulate(rays_a: np.ndarray, rays_b: np.ndarray, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Depths along both rays (`[N, 3]` with z = 1: camera z) where they come closest; `pose` maps A's frame to B's.

    Least squares of `depth_a R ray_a + t = depth_b ray_b`; nearly parallel rays give huge depths of either sign.
    """
    turned = rays_a @ pose.rotation.T
    aa, bb, ab = (turned * turned).sum(1), (rays_b * rays_b).sum(1), (turned * rays_b).sum(1)
    at, bt = turned @ pose.translation, rays_b @ pose.translation
    determinant = np.maximum(aa * bb - ab * ab, 1e-12)
    return (ab * bt - at * bb) / determinant, (aa * bt - ab * at) / determinant


def parallax_degrees(rays_a: np.ndarray, rays_b: np.ndarray, pose: Pose) -> np.ndarray:
    """Angle between the two rays of each point [degrees]."""
    turned = rays_a @ pose.rotation.T
    across = np.linalg.norm(np.cross(turned, rays_b), axis=1)
    return np.degrees(np.arctan2(across, (turned * rays_b).sum(1)))
