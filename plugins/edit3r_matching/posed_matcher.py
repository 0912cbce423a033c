"""The matcher `posed`: depth from poses that are known, by the plane sweep of the matcher `classical`."""

from itertools import combinations

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from edit3r import config
from edit3r.config import PartChoice
from edit3r.errors import MatchingError
from edit3r.geometry.cameras import relative_to_first, to_pixels
from edit3r.geometry.upsampling import upsample_depth
from edit3r.interfaces import MatchedGeometry, Matcher
from edit3r.types import Views
from edit3r_matching.camera import Picture, Pose, cross_matrix, rays_through
from edit3r_matching.dense import ViewDepth, dense_depth
from edit3r_matching.features import Keypoints, detect, match
from edit3r_matching.registration import PairView, Registration
from edit3r_matching.relative_pose import Matches
from edit3r_matching.triangulation import parallax_degrees, triangulate

__all__ = ["PosedMatcher"]

LEAST_MATCHES = 8
"""Matches on the known epipolar lines that two views must share for one to help the other's depth."""


class PosedMatcher(Matcher):
    """Trusts the views' own poses; views without any go to the matcher it was built with.

    Features that agree with the known epipolar geometry tell the range of depths, plane sweep measures it.
    """

    class Settings(config.Settings):
        working_size: int = Field(
            320, ge=64, le=1024, description="long side at which depth is measured [pixels]; time grows with its cube"
        )
        matcher: PartChoice = Field(PartChoice(name="classical"), description="what matches views without known poses")
        planes: int = Field(128, ge=24, le=512, description="most depth hypotheses a pixel; fewer is quicker, coarser")
        neighbours: int = Field(2, ge=1, le=8, description="most views that help to measure the depth of one")
        keypoints: int = Field(4000, ge=200, le=20000, description="most features a photo")
        detection_size: int = Field(640, ge=128, le=4096, description="long side at which features are looked for")
        ratio: float = Field(0.85, gt=0, le=1, description="a match must be this much nearer than its second choice")
        threshold: float = Field(1.5, gt=0, le=20, description="distance from the known epipolar line [pixels]")

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings, self.matcher = settings, matcher

    def match(self, views: Views) -> MatchedGeometry:
        if views.c2w is None:
            return self.matcher.match(views)
        poses = relative_to_first(views.c2w.detach().double().cpu())
        scenes = [self._scene(views, scene, poses[scene]) for scene in range(len(views.images))]
        depths, confidence, registered = (torch.stack(field).to(views.images.device) for field in zip(*scenes))
        return MatchedGeometry(poses.to(views.images), depths, confidence, registered)

    def _scene(self, views: Views, scene: int, c2w: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Depths, confidence and which views have any, of one scene."""
        chosen = self.settings
        pictures = _pictures(views, scene)
        poses = tuple(Pose.from_matrix(matrix).inverse() for matrix in c2w.numpy())
        keys = [detect(picture.image, chosen.keypoints, chosen.detection_size) for picture in pictures]
        pairs = {}
        for a, b in combinations(range(len(pictures)), 2):
            found = self._pair((pictures[a], pictures[b]), (keys[a], keys[b]), poses[b].after(poses[a].inverse()))
            if found is not None:
                pairs[a, b] = found
        placed = np.array([any(view in pair for pair in pairs) for view in range(len(pictures))])
        if not placed[0]:
            raise MatchingError(
                "view 0 shares too few features with the other photos on the lines that the known poses give; "
                "look whether poses and photos belong together."
            )
        small = [_reduced(picture, chosen.working_size) for picture in pictures]
        depths = dense_depth(small, Registration(poses, placed, pairs), chosen.neighbours, chosen.planes)
        maps = [_full_size(depth, *pair) for depth, pair in zip(depths, zip(small, pictures))]
        inverse, confidence = (torch.from_numpy(np.stack(part)).to(views.images.dtype) for part in zip(*maps))
        return 1 / inverse, confidence, torch.from_numpy(placed)

    def _pair(
        self, pictures: tuple[Picture, Picture], keys: tuple[Keypoints, Keypoints], pose: Pose
    ) -> PairView | None:
        """Matches that agree with the known `pose` (first view's frame to the second's); None when there are few."""
        indices = match(*keys, self.settings.ratio)
        rays = [rays_through(k.points[indices[:, i]], p.intrinsics) for i, (k, p) in enumerate(zip(keys, pictures))]
        focal = float(np.mean([p.intrinsics[axis, axis] for p in pictures for axis in (0, 1)]))
        near = _epipolar_distance(*rays, pose) * focal <= self.settings.threshold
        depth, other = triangulate(rays[0], rays[1], pose)
        agreeing = near & (depth > 0) & (other > 0)
        if agreeing.sum() < LEAST_MATCHES:
            return None
        height, width = pictures[1].size
        chance = 2 * np.hypot(height, width) / (height * width)
        matches = Matches(rays[0][agreeing], rays[1][agreeing], focal, chance)
        return PairView(matches, indices[agreeing], pose, parallax_degrees(matches.rays_a, matches.rays_b, pose))


def _pictures(views: Views, scene: int) -> list[Picture]:
    images = views.images[scene].detach().permute(0, 2, 3, 1).cpu().float().numpy()
    intrinsics = to_pixels(views.intrinsics[scene].detach().double().cpu(), views.image_size).numpy()
    return [Picture(np.ascontiguousarray(image), matrix) for image, matrix in zip(images, intrinsics)]


def _reduced(photo: Picture, working_size: int) -> Picture:
    """The photo with a long side of at most `working_size`."""
    height, width = photo.size
    scale = min(1.0, working_size / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    stretch = np.array([[size[0] / width], [size[1] / height], [1.0]])
    return Picture(cv2.resize(photo.image, size, interpolation=cv2.INTER_AREA), photo.intrinsics * stretch)


def _full_size(depth: ViewDepth | None, small: Picture, photo: Picture) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and confidence at the photo's size; depth 1 and confidence 0 for a view without any."""
    if depth is None:
        return np.ones(photo.size, np.float32), np.zeros(photo.size, np.float32)
    return upsample_depth(depth.inverse, depth.measured, small.image, photo.image)


def _epipolar_distance(rays_a: np.ndarray, rays_b: np.ndarray, pose: Pose) -> np.ndarray:
    """Distance of each second ray's point (z = 1) from the line that the first one and the pose give."""
    lines = rays_a @ (cross_matrix(pose.translation) @ pose.rotation).T
    return np.abs((lines * rays_b).sum(-1)) / np.maximum(np.linalg.norm(lines[:, :2], axis=-1), 1e-12)
