"""The matcher `classical`: where the photos were taken and how far every pixel is, without learned weights."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.geometry.cameras import from_pixels, to_pixels
from edit3r.geometry.upsampling import upsample_depth
from edit3r.interfaces import MatchedGeometry, Matcher
from edit3r.stage_checks import require_matchable
from edit3r.types import Views
from edit3r_matching.calibration import calibrate
from edit3r_matching.camera import Picture
from edit3r_matching.dense import ViewDepth, dense_depth
from edit3r_matching.registration import FoundFeatures, Registration, RegistrationOptions, find_features, register

__all__ = ["ClassicalMatcher"]

MIN_SIZE = 32
"""Pictures with a shorter side than this show too little to match [pixels]."""


class ClassicalMatcher(Matcher):
    """Features, essential matrices, plane sweep, semi-global aggregation, cross-check and edge-aware filling.

    Confidence is 1 where two views measured the same surface and 0 where the depth was filled in, between the two only
    along the border of such regions where depth was carried to a larger picture.

    Quicker and a little worse: `working_size=192, detection_size=512`, two thirds of the time at 256².
    """

    class Settings(config.Settings):
        working_size: int = Field(
            320, ge=64, le=1024, description="long side at which depth is measured [pixels]; time grows with its cube"
        )
        planes: int = Field(128, ge=24, le=512, description="most depth hypotheses a pixel; fewer is quicker, coarser")
        neighbours: int = Field(2, ge=1, le=8, description="most views that help to measure the depth of one")
        keypoints: int = Field(4000, ge=200, le=20000, description="most features a photo")
        detection_size: int = Field(
            640, ge=128, le=4096, description="long side at which features are looked for [pixels]; larger finds more"
        )
        ratio: float = Field(
            0.85, gt=0, le=1, description="a match must be this much nearer than its second choice (Lowe's test)"
        )
        threshold: float = Field(
            1.0, gt=0, le=10, description="distance from the epipolar line that agrees [pixels at a long side of 256]"
        )
        calibrate: bool = Field(
            True, description="read the field of view from the photos where neither EXIF nor the user tells it"
        )
        seed: int = Field(0, ge=0, description="seed of the robust estimates")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def match(self, views: Views) -> MatchedGeometry:
        require_matchable(views, MIN_SIZE)
        scenes = [self._match_scene(views, scene) for scene in range(views.images.shape[0])]
        *measured, intrinsics = (torch.stack(field).to(views.images.device) for field in zip(*scenes))
        return MatchedGeometry(*measured, intrinsics if self._reads_fov(views) else None)

    def _reads_fov(self, views: Views) -> bool:
        """Whether the field of view is to be read from the photos: where none of them knows its own."""
        return self.settings.calibrate and bool(views.assumed) and all(views.assumed)

    def _match_scene(self, views: Views, scene: int) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Poses, depths, confidence, registered flags and intrinsics of one scene."""
        chosen = self.settings
        photos = _pictures(views, scene)
        names = views.names or tuple(f"view {index}" for index in range(views.count))
        options = RegistrationOptions(
            chosen.keypoints, chosen.detection_size, chosen.ratio, chosen.threshold, chosen.seed
        )
        features = find_features(photos, options)
        photos = self._calibrated(photos, features, views)
        registration = register(photos, names, features, options)
        _report(registration, names)
        small = [_reduced(photo, chosen.working_size) for photo in photos]
        depths = dense_depth(small, registration, chosen.neighbours, chosen.planes)
        maps = [_full_size(depth, little, photo) for depth, little, photo in zip(depths, small, photos)]
        like = views.images
        c2w = torch.from_numpy(np.stack([pose.inverse().matrix for pose in registration.poses])).to(like.dtype)
        inverse, confidence = (torch.from_numpy(np.stack(part)).to(like.dtype) for part in zip(*maps))
        intrinsics = from_pixels(torch.from_numpy(np.stack([photo.intrinsics for photo in photos])), views.image_size)
        return c2w, 1 / inverse, confidence, torch.from_numpy(registration.registered), intrinsics.to(like.dtype)

    def _calibrated(self, photos: Sequence[Picture], features: FoundFeatures, views: Views) -> Sequence[Picture]:
        """The photos with a field of view read from their matches, where they have enough."""
        if not self._reads_fov(views):
            return photos
        pairs = {(a, b): features.matches(photos, a, b) for a, b in features.indices}
        read = calibrate(photos, pairs, self.settings.threshold, self.settings.seed)
        if read is None:
            return photos
        reporting.note("matcher.fov", round(read.fov, 1))
        return [_with_fov(photo, read.fov) for photo in photos]


def _pictures(views: Views, scene: int) -> list[Picture]:
    """The photos of one scene as arrays, intrinsics in pixels."""
    images = views.images[scene].detach().permute(0, 2, 3, 1).cpu().float().numpy()
    intrinsics = to_pixels(views.intrinsics[scene].detach().double().cpu(), views.image_size).numpy()
    return [Picture(np.ascontiguousarray(image), matrix) for image, matrix in zip(images, intrinsics)]


def _with_fov(photo: Picture, fov: float) -> Picture:
    """The photo through a lens with a field of view of `fov` [degrees] across its longer side."""
    focal = 0.5 * max(photo.size) / np.tan(np.radians(fov) / 2)
    intrinsics = photo.intrinsics.copy()
    intrinsics[0, 0] = intrinsics[1, 1] = focal
    return Picture(photo.image, intrinsics)


def _reduced(photo: Picture, working_size: int) -> Picture:
    """The photo with a long side of at most `working_size`."""
    height, width = photo.size
    scale = min(1.0, working_size / max(height, width))
    if scale == 1.0:
        return photo
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    stretch = np.array([[size[0] / width], [size[1] / height], [1.0]])
    return Picture(cv2.resize(photo.image, size, interpolation=cv2.INTER_AREA), photo.intrinsics * stretch)


def _full_size(depth: ViewDepth | None, small: Picture, photo: Picture) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and confidence for every pixel of the photo; depth 1 and confidence 0 for a view not placed."""
    if depth is None:
        return np.ones(photo.size, np.float32), np.zeros(photo.size, np.float32)
    return upsample_depth(depth.inverse, depth.measured, small.image, photo.image)


def _report(registration: Registration, names: Sequence[str]) -> None:
    reporting.note(
        "matcher.inliers", {f"{names[a]} {names[b]}": len(p.matches) for (a, b), p in registration.pairs.items()}
    )
    lost = [name for name, placed in zip(names, registration.registered) if not placed]
    if lost:
        reporting.warn(
            f"{', '.join(lost)}: shares too few points with the other photos to be placed, so it is left out."
        )
