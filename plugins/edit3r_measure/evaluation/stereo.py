"""Depth against the truth: a posed folder of a rectified pair with `disparity_left.npz`.

Its key `disparity` holds pixels at the stored size, 0 unknown; a point at x in the left picture is at x - disparity in
the right one.
"""

import cv2
import numpy as np
import torch

from edit3r.errors import InputError
from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.io.framing import frame_for
from edit3r.io.posed_folder import PosedFolder
from edit3r.types import Cameras
from edit3r_measure.evaluation.metrics import within_share
from edit3r_measure.evaluation.novel_view import views_of

__all__ = ["DISPARITY_FILE", "has_disparity", "score_stereo"]

DISPARITY_FILE = "disparity_left.npz"


def has_disparity(folder: PosedFolder) -> bool:
    """Whether the folder brings the truth that `score_stereo` needs."""
    return (folder.path / DISPARITY_FILE).is_file()


def score_stereo(
    folder: PosedFolder, reconstructor: Reconstructor, rasterizer: Rasterizer, size: int, tolerance: float = 0.1
) -> float:
    """Share of the left picture's known pixels whose rendered depth is within `tolerance` after one scale.

    Raises MatchingError when the two photos cannot be placed.
    """
    left, right = (folder.load(index, size) for index in (0, 1))
    truth = true_depth(folder, size)
    with torch.no_grad():
        reconstruction = reconstructor(views_of([left, right]))
        like = reconstruction.gaussians.means
        c2w = torch.eye(4).to(like)[None, None]
        cameras = Cameras(c2w, torch.from_numpy(left.intrinsics).to(like)[None, None], (size, size))
        depth = rasterizer.render(reconstruction.gaussians, cameras).depths[0, 0, 0].cpu().numpy()
    return within_share(depth, truth, tolerance)


def true_depth(folder: PosedFolder, size: int) -> np.ndarray:
    """Camera z of the left photo's centred square [baselines], 0 where unknown."""
    with np.load(folder.path / DISPARITY_FILE) as file:
        disparity = file["disparity"].astype(np.float32)
    left, right = folder.cameras[:2]
    if disparity.shape != (left.height, left.width):
        raise InputError(
            f"{folder.path / DISPARITY_FILE}: expected {left.height} rows of {left.width}, got {disparity.shape}."
        )
    # The principal points differ between the two pictures of some data sets.
    motion = disparity + right.K[0, 2] - left.K[0, 2]
    depth = np.where((disparity > 0) & (motion > 0), left.K[0, 0] / np.where(motion > 0, motion, 1), 0)
    x0, y0, x1, y1 = (round(edge) for edge in frame_for(disparity.shape, (size, size)).box)
    return cv2.resize(depth[y0:y1, x0:x1], (size, size), interpolation=cv2.INTER_NEAREST)
