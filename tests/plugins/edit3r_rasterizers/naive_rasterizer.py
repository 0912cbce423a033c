"""An independent renderer: numpy, float64, one Gaussian after the other over the whole picture,
textbook formulas.
"""

from dataclasses import dataclass

import numpy as np

from edit3r.contract.types import Cameras, Gaussians

# Real spherical harmonics as in "3D Gaussian Splatting", written out from the definition: rows are
# (l, m), functions of x, y, z on the unit sphere, with the Condon-Shortley sign.
SH = [
    lambda x, y, z: 0.5 * np.sqrt(1 / np.pi) + 0 * x,
    lambda x, y, z: -np.sqrt(3 / (4 * np.pi)) * y,
    lambda x, y, z: np.sqrt(3 / (4 * np.pi)) * z,
    lambda x, y, z: -np.sqrt(3 / (4 * np.pi)) * x,
    lambda x, y, z: 0.5 * np.sqrt(15 / np.pi) * x * y,
    lambda x, y, z: -0.5 * np.sqrt(15 / np.pi) * y * z,
    lambda x, y, z: 0.25 * np.sqrt(5 / np.pi) * (3 * z**2 - 1),
    lambda x, y, z: -0.5 * np.sqrt(15 / np.pi) * x * z,
    lambda x, y, z: 0.25 * np.sqrt(15 / np.pi) * (x**2 - y**2),
    lambda x, y, z: -0.25 * np.sqrt(35 / (2 * np.pi)) * y * (3 * x**2 - y**2),
    lambda x, y, z: 0.5 * np.sqrt(105 / np.pi) * x * y * z,
    lambda x, y, z: -0.25 * np.sqrt(21 / (2 * np.pi)) * y * (5 * z**2 - 1),
    lambda x, y, z: 0.25 * np.sqrt(7 / np.pi) * (5 * z**3 - 3 * z),
    lambda x, y, z: -0.25 * np.sqrt(21 / (2 * np.pi)) * x * (5 * z**2 - 1),
    lambda x, y, z: 0.25 * np.sqrt(105 / np.pi) * (x**2 - y**2) * z,
    lambda x, y, z: -0.25 * np.sqrt(35 / (2 * np.pi)) * x * (x**2 - 3 * y**2),
    lambda x, y, z: 0.75 * np.sqrt(35 / np.pi) * x * y * (x**2 - y**2),
    lambda x, y, z: -0.75 * np.sqrt(35 / (2 * np.pi)) * y * (3 * x**2 - y**2) * z,
    lambda x, y, z: 0.75 * np.sqrt(5 / np.pi) * x * y * (7 * z**2 - 1),
    lambda x, y, z: -0.75 * np.sqrt(5 / (2 * np.pi)) * y * (7 * z**3 - 3 * z),
    lambda x, y, z: 3 / 16 * np.sqrt(1 / np.pi) * (35 * z**4 - 30 * z**2 + 3),
    lambda x, y, z: -0.75 * np.sqrt(5 / (2 * np.pi)) * x * (7 * z**3 - 3 * z),
    lambda x, y, z: 3 / 8 * np.sqrt(5 / np.pi) * (x**2 - y**2) * (7 * z**2 - 1),
    lambda x, y, z: -0.75 * np.sqrt(35 / (2 * np.pi)) * x * (x**2 - 3 * y**2) * z,
    lambda x, y, z: 3 / 16 * np.sqrt(35 / np.pi) * (x**4 - 6 * x**2 * y**2 + y**4),
]


@dataclass
class Picture:
    """One camera's answer, and where it hangs on a decision that float32 may take the other way."""

    image: np.ndarray  # [3, H, W]
    alpha: np.ndarray  # [H, W]
    depth: np.ndarray  # [H, W]
    fragile: np.ndarray  # [H, W], True: do not compare


def render(
    gaussians: Gaussians,
    cameras: Cameras,
    scene: int = 0,
    camera: int = 0,
    background=(0.0, 0.0, 0.0),
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    max_alpha: float = 0.999,
) -> Picture:
    means, scales, quats, opacities, harmonics = (
        getattr(gaussians, name)[scene].detach().double().numpy()
        for name in ("means", "scales", "quats", "opacities", "harmonics")
    )
    c2w = cameras.c2w[scene, camera].double().numpy()
    height, width = cameras.image_size
    matrix = cameras.intrinsics[scene, camera].double().numpy()
    (fx, cx), (fy, cy) = matrix[0, [0, 2]] * width, matrix[1, [1, 2]] * height
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    image, depth = np.zeros((3, height, width)), np.zeros((height, width))
    left = np.ones((height, width))
    ended, fragile = np.zeros((height, width), bool), np.zeros((height, width), bool)
    view = means - c2w[:3, 3]
    view = view @ c2w[:3, :3]
    drawn_z = np.full((height, width), -np.inf)
    for i in np.argsort(view[:, 2], kind="stable"):
        z = view[i, 2]
        if not near_plane <= z <= far_plane:
            continue
        mean, cov = _project(
            view[i], scales[i], quats[i], c2w, (fx, fy, cx, cy), (width, height), eps2d
        )
        offset = np.stack((x - mean[0], y - mean[1]))
        sigma = 0.5 * np.einsum("ihw,ij,jhw->hw", offset, _inverse(cov), offset)
        alpha = np.minimum(max_alpha, opacities[i] * np.exp(-np.maximum(sigma, 0)))
        after = left * (1 - alpha)
        seen = alpha >= 1 / 255
        near_decision = (np.abs(alpha * 255 - 1) < 1e-3) | (
            seen & (np.abs(after / 1e-4 - 1) < 1e-2)
        )
        # order in float32
        near_decision |= seen & (z - drawn_z < 1e-6 * z) & (z != drawn_z)
        fragile |= near_decision & ~ended
        ended |= seen & ~ended & (after <= 1e-4)
        shown = seen & ~ended
        colour = _colour(harmonics[i], means[i] - c2w[:3, 3])
        weight = np.where(shown, alpha * left, 0)
        image += weight * colour[:, None, None]
        depth += weight * z
        left = np.where(shown, after, left)
        drawn_z = np.where(shown, z, drawn_z)
    alpha = 1 - left
    image += left * np.asarray(background, float)[:, None, None]
    return Picture(image, alpha, depth / np.maximum(alpha, 1e-10), fragile)


def _project(position, scales, quat, c2w, intrinsics, size, eps2d):
    fx, fy, cx, cy = intrinsics
    x, y, z = position
    u, v = x / z, y / z
    margin_x, margin_y = 0.15 * size[0] / fx, 0.15 * size[1] / fy
    clamped_u = min(max(u, -(cx / fx) - margin_x), (size[0] - cx) / fx + margin_x)
    clamped_v = min(max(v, -(cy / fy) - margin_y), (size[1] - cy) / fy + margin_y)
    jacobian = np.array(
        [[fx / z, 0, -fx * clamped_u / z], [0, fy / z, -fy * clamped_v / z]]
    )
    factor = jacobian @ c2w[:3, :3].T @ _rotation(quat) @ np.diag(scales)
    return (fx * u + cx, fy * v + cy), factor @ factor.T + eps2d * np.eye(2)


def _inverse(cov):
    """Through the eigenvectors, which is accurate for needles."""
    values, vectors = np.linalg.eigh(cov.astype(np.longdouble).astype(float))
    return vectors @ np.diag(1 / values) @ vectors.T


def _rotation(quat):
    norm = np.linalg.norm(quat)
    w, x, y, z = quat / norm if norm > 1e-12 else (1.0, 0.0, 0.0, 0.0)
    axis = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * axis + 2 * axis @ axis  # Rodrigues


def _colour(harmonics, offset):
    direction = offset / np.linalg.norm(offset)
    return np.maximum(
        0, sum(SH[k](*direction) * harmonics[k] for k in range(len(harmonics))) + 0.5
    )
