"""Poses of the input views from predicted Gaussians: their centres against their pixels.

For reconstructors that predict no cameras. PnP with RANSAC, after the evaluation of pose-free
splatting (Ye et al., NoPoSplat, ICLR 2025).
"""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import MatchingError
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.geometry.cameras import to_pixels

MIN_OPACITY = 0.3
"""Fainter Gaussians are guesses and do not vote. No figure kept."""
MAX_POINTS = 8192
"""Centres used per view, evenly spread over its pixels; more change nothing but the time."""
MIN_POINTS = 8
ITERATIONS = 100
REPROJECTION_ERROR = 5 / 256
"""Largest distance of an inlier from its pixel, as a share of the longer side of the grid."""


def estimate_cameras(gaussians: Gaussians, views: Views, per_pixel: int = 1) -> Cameras:
    """Cameras of `views` in the frame of `gaussians`; view 0 is the identity.

    Uses `gaussians.view_index` and the order of each view's Gaussians: `per_pixel` of each pixel,
    row-major, on the grid that `pixel_layout` finds. Deterministic, not differentiable. Raises
    MatchingError for a view that cannot be placed.
    """
    if per_pixel == 0:
        raise MatchingError(
            "the Gaussians are not made pixel by pixel, so they tell no poses; choose a "
            "reconstructor that predicts cameras itself, or a head with Gaussians of each pixel."
        )
    poses = [
        _scene_poses(gaussians, views, scene, per_pixel)
        for scene in range(len(views.images))
    ]
    c2w = torch.from_numpy(np.stack(poses)).to(views.images)
    return Cameras(c2w, views.intrinsics, views.image_size)


def pixel_layout(count: int, image_size: tuple[int, int]) -> tuple[int, int]:
    """(height, width) with height * width = count nearest in shape to an image of `image_size`."""
    wanted = image_size[0] / image_size[1]
    heights = [h for h in range(1, count + 1) if count % h == 0]
    height = min(heights, key=lambda h: abs(np.log(h * h / count / wanted)))
    return height, count // height


def _scene_poses(
    gaussians: Gaussians, views: Views, scene: int, per_pixel: int
) -> Float[np.ndarray, "view 4 4"]:
    """Camera-to-world poses of one scene's views."""
    poses = [np.eye(4)]
    for view in range(1, views.count):
        of_view = gaussians.view_index == view
        points = gaussians.means[scene, of_view]
        if not len(points):
            raise MatchingError(f"view {view} has 0 Gaussians, expected one per pixel.")
        layout = pixel_layout(len(points) // per_pixel, views.image_size)
        name = views.called[view]
        poses.append(
            _pose(
                points,
                gaussians.opacities[scene, of_view],
                views.intrinsics[scene, view],
                layout,
                per_pixel,
                name,
            )
        )
    return np.stack(poses)


def _pose(
    points: Float[Tensor, "gaussian 3"],
    opacities: Float[Tensor, "gaussian"],
    intrinsics: Float[Tensor, "3 3"],
    layout: tuple[int, int],
    per_pixel: int,
    name: str,
) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world pose under which each point falls on its pixel."""
    centres, pixels = _voters(points, opacities, layout, per_pixel)
    if len(centres) < MIN_POINTS:
        raise MatchingError(
            f"{name} cannot be placed: only {len(centres)} of its Gaussians are visible enough, "
            f"{MIN_POINTS} are needed."
        )
    # PnP is better conditioned near 1
    unit = float(np.median(np.linalg.norm(centres, axis=1))) or 1.0
    camera = to_pixels(intrinsics.detach().cpu().double(), layout).numpy()
    solved, rotation, translation, inliers = cv2.solvePnPRansac(
        centres / unit,
        pixels,
        camera,
        None,
        iterationsCount=ITERATIONS,
        reprojectionError=REPROJECTION_ERROR * max(layout),
        confidence=0.9999,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not solved or inliers is None or len(inliers) < MIN_POINTS:
        raise MatchingError(
            f"{name} cannot be placed: its Gaussians fit no camera; the photos may not overlap "
            "enough."
        )
    chosen = inliers[:, 0]
    rotation, translation = cv2.solvePnPRefineLM(
        centres[chosen] / unit, pixels[chosen], camera, None, rotation, translation
    )
    # OpenCV's rotation vector and translation take the world to the camera
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(rotation)[0].T
    pose[:3, 3] = -pose[:3, :3] @ (translation[:, 0] * unit)
    return pose


def _voters(
    points: Float[Tensor, "gaussian 3"],
    opacities: Float[Tensor, "gaussian"],
    layout: tuple[int, int],
    per_pixel: int,
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 2"]]:
    """Visible, finite centres and the (x, y) of their pixels, thinned evenly."""
    visible = (opacities > MIN_OPACITY) & points.isfinite().all(-1)
    every = visible.nonzero()[:, 0]
    index = every[:: max(1, -(-len(every) // MAX_POINTS))].cpu().numpy()
    pixel = index // per_pixel
    pixels = np.stack((pixel % layout[1] + 0.5, pixel // layout[1] + 0.5), -1)
    chosen = points[torch.from_numpy(index).to(points.device)]
    return chosen.detach().cpu().double().numpy(), pixels
