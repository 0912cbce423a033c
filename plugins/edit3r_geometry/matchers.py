"""The matchers `classical` and `posed`, which need no weights, and `auto`, which picks."""

import functools
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field, model_validator
from torch import Tensor

import edit3r
from edit3r import build, default_registry
from edit3r.contract import reporting
from edit3r.contract.component import component_name
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher, MatchesCorrected
from edit3r.contract.lens import Lens
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit.cache import fingerprint, identity, remembered
from edit3r.kit.checks import require_matchable
from edit3r.kit.geometry.cameras import from_pixels, relative_to_first
from edit3r_geometry.calibration import calibrate, contradiction
from edit3r_geometry.cameras import CalibratedImage, Pose, calibrated_images
from edit3r_geometry.depth_maps import DepthSettings, measure_depths
from edit3r_geometry.features import (
    FeatureSettings,
    FoundFeatures,
    find_features,
    with_learned,
    with_tilted,
)
from edit3r_geometry.pairs import NEARLY_ALL, agreeing_pairs, on_a_plane
from edit3r_geometry.registration import Registration, register

MIN_SIZE = 32
"""Images with a shorter side than this show too little to match [pixels]."""
LEAST_DISTORTION = 0.03
"""Radial distortion (k1) below which a lens is taken for a plain one: so much is found on straight
photos too. See docs/notes/classical.md.
"""
LEAST_GAIN = 0.05
"""Share of the points' distance from their pixels that a distortion must explain before it is
believed. No figure kept.
"""


class _RememberingMatcher(Matcher, MatchesCorrected):
    """Asks `_geometry`, whose depths may be measured in one exposure, once for the same photos."""

    @remembered
    def match(self, views: Views) -> Geometry:
        return self._geometry(views, views)

    @remembered
    def match_corrected(self, views: Views, corrected: Views) -> Geometry:
        return self._geometry(views, corrected)

    @abstractmethod
    def _geometry(self, views: Views, corrected: Views) -> Geometry: ...


class ClassicalMatcher(_RememberingMatcher):
    """Features, essential matrices, plane sweep, semi-global aggregation, cross-check and
    edge-aware filling.

    Confidence is 1 where two views measured the same surface and 0 where the depth was filled in,
    between the two only along the border of such regions where depth was carried to a larger image.

    Quicker: `detection_size=448`, which reads the lens of photos from wide apart worse. Finer:
    `working_size=320, planes=128, coarse=true`, as `--quality best` has it.
    """

    class Settings(FeatureSettings, DepthSettings):
        threshold: float = Field(1.0, gt=0, le=10)
        """distance from the epipolar line that agrees [pixels at a long side of 256]"""
        calibrate: bool = True
        """read the field of view from the photos where neither EXIF nor the user tells it"""
        tilted: bool = True
        """where photos cannot be placed, match them again as they look from aside: for photos from
        wide apart, takes some seconds
        """
        seed: int = Field(0, ge=0)
        """seed of the robust estimates"""

    settings: Settings

    def _geometry(self, views: Views, corrected: Views) -> Geometry:
        require_matchable(views, MIN_SIZE)
        scenes = [
            self._match_scene(views, corrected, scene)
            for scene in range(views.images.shape[0])
        ]
        *measured, fov_ranges, told = zip(*scenes)
        known = not self._reads_fov(views)
        c2w, depths, confidence, registered, intrinsics = (
            torch.stack(field).to(views.images.device) for field in measured
        )
        return Geometry(
            c2w,
            depths,
            confidence,
            registered,
            None if known else intrinsics,
            next(filter(None, fov_ranges), None),
            next(filter(None, told), None) if known else None,
        )

    def _reads_fov(self, views: Views) -> bool:
        """Whether the photos are to tell the field of view: where none knows its own."""
        return self.settings.calibrate and bool(views.assumed) and all(views.assumed)

    def lens(self, views: Views) -> Lens | None:
        if views.count < 3 or len(views.images) > 1 or not self._reads_fov(views):
            return None
        from edit3r_geometry.bundle_adjustment import fit_distortion

        try:
            found = _registered(_Asked.of(self, views, 0))
        except MatchingError:  # told when the photos are matched
            return None
        views_placed = np.flatnonzero(found.registration.registered).tolist()
        if len(views_placed) < 3:  # two see the same, whatever the lens
            return None
        limit = self.settings.threshold * max(found.images[0].size) / 256
        # a camera that only turned: the motion is invented, and a bend with it
        if all(
            on_a_plane(pair.matches, limit, NEARLY_ALL)
            for pair in found.registration.pairs.values()
        ):
            return None
        poses = {view: found.registration.poses[view] for view in views_placed}
        matches = {
            pair: view.indices for pair, view in found.registration.pairs.items()
        }
        points = [keypoints.points for keypoints in found.features.keypoints]
        radial, gain = fit_distortion(found.images, points, matches, poses, 2 * limit)
        if abs(radial) < LEAST_DISTORTION or gain < LEAST_GAIN:
            return None
        (fx, _, cx), (_, fy, cy), _ = found.normalised(views.image_size)[0].tolist()
        return Lens((fx, fy), (cx, cy), (radial, 0.0, 0.0, 0.0, 0.0))

    def _match_scene(
        self, views: Views, corrected: Views, scene: int
    ) -> tuple[Any, ...]:
        """Fields of `Geometry` of one scene: poses, depths, confidence, registered flags,
        intrinsics, fields of view that explain the photos alike, and the one that the matches tell.
        """
        unknown = self._reads_fov(views)
        found = _registered(_Asked.of(self, views, scene))
        registration = found.registration
        if unknown and (found.told is not None or registration.zoom != 1):
            reporting.note("matcher.fov", round(found.images[0].fov, 1))
        _report(registration, found.features, views.called)
        if unknown and found.features.tilted:
            reporting.warn(
                "The photos were taken from wide apart, and such photos tell little about their "
                f"lens. A field of view of {found.images[0].fov:.0f} degrees across the longer "
                "side was read. Give --fov if you know it: with a wrong one the scene is bent."
            )
        poses = np.stack([pose.inverse().matrix for pose in registration.poses])
        images = [
            replace(image, pixels=shown.pixels)
            for image, shown in zip(found.images, calibrated_images(corrected, scene))
        ]
        maps = (poses, *measure_depths(images, registration, self.settings))
        c2w, inverse, confidence = (
            torch.from_numpy(part).to(views.images.dtype) for part in maps
        )
        intrinsics = found.normalised(views.image_size).to(c2w)
        return (
            c2w,
            1 / inverse,
            confidence,
            torch.from_numpy(registration.registered),
            intrinsics,
            found.fov_range,
            found.told,
        )

    def register(self, views: Views, scene: int) -> "_Registered":
        """Where a scene's photos were taken, and the field of view they tell or contradict."""
        images = calibrated_images(views, scene)
        features = find_features(images, self.settings)
        found = self._attempt(views, images, features)
        # Of three photos and more, bundle adjustment settles the lens.
        if len(images) == 2 and isinstance(found, _Registered) and found.fov_range:
            helped = with_learned(features, images, self.settings)
            if helped is not features:
                again = self._attempt(views, images, helped)
                if len(lost_in(again, views.count)) <= len(lost_in(found, views.count)):
                    features, found = helped, again
        lost = lost_in(found, views.count)
        if lost and self.settings.tilted and not features.helper:
            tilted = with_tilted(features, images, lost, self.settings)
            again = self._attempt(views, images, tilted)
            if len(lost_in(again, views.count)) <= len(lost):
                found = again
        if isinstance(found, MatchingError):
            raise found
        if found.told is not None and not self._reads_fov(views):
            reporting.warn(
                f"The photos tell a field of view of about {found.told:.0f} degrees across the "
                f"longer side, not the {images[0].fov:.0f} that were given by --fov, EXIF or a "
                "camera file: with a wrong one the scene is bent. Leave --fov out, or give the "
                "right one."
            )
        return found

    def _attempt(
        self, views: Views, images: Sequence[CalibratedImage], features: FoundFeatures
    ) -> "_Registered | MatchingError":
        """The photos registered by these features, or why that was not possible."""
        chosen = self.settings
        unknown = self._reads_fov(views)
        pairs = {(a, b): features.matches(images, a, b) for a, b in features.indices}
        asked = images, pairs, chosen.threshold, chosen.seed
        told, fov_range = None, None
        if unknown:
            reading = calibrate(*asked)
            if reading is not None:
                told, fov_range = reading.fov, reading.alike
                images = [image.with_fov(told) for image in images]
        else:
            told = contradiction(*asked)
        try:
            registration = register(
                images,
                views.called,
                features,
                chosen.threshold,
                chosen.seed,
                # Where the matches of each pair tell no lens, all views' together bend it away.
                free_focal=unknown and fov_range is None,
            )
        except MatchingError as error:
            return error
        zoomed = tuple(image.zoomed(registration.zoom) for image in images)
        return _Registered(zoomed, features, registration, told, fov_range)


@dataclass(frozen=True)
class _Registered:
    """Photos with the intrinsics that they were registered with."""

    images: tuple[CalibratedImage, ...]
    features: FoundFeatures
    registration: Registration
    told: float | None  # field of view that the matches tell [degrees]
    # the narrowest and widest that explain them alike, where these are far apart
    fov_range: tuple[float, float] | None = None

    def without_pixels(self) -> "_Registered":
        """The same without what was compared, which of many photos is most of it."""
        return replace(
            self,
            images=tuple(image.without_pixels() for image in self.images),
            features=self.features.without_descriptors(),
        )

    def normalised(self, size: tuple[int, int]) -> Float[Tensor, "view 3 3"]:
        """The intrinsics as shares of the photos' (height, width)."""
        return from_pixels(
            torch.from_numpy(np.stack([image.K for image in self.images])),
            size,
        )


def lost_in(found: "_Registered | MatchingError", views: int) -> list[int]:
    """The photos that could not be placed."""
    if isinstance(found, MatchingError):
        return list(range(views))
    return np.flatnonzero(~found.registration.registered).tolist()


@dataclass(frozen=True)
class _Asked:
    """A scene to register; equal to another one of the same photos and settings."""

    key: str
    matcher: ClassicalMatcher = field(compare=False)
    views: Views = field(compare=False)
    scene: int = field(compare=False)

    @staticmethod
    def of(matcher: ClassicalMatcher, views: Views, scene: int) -> "_Asked":
        return _Asked(
            fingerprint(identity(matcher), views, scene), matcher, views, scene
        )


# Who reads the lens of photos matches them next, and once more when their light is corrected.
@functools.lru_cache(maxsize=1)
def _registered(asked: _Asked) -> _Registered:
    return asked.matcher.register(asked.views, asked.scene).without_pixels()


class PosedMatcher(_RememberingMatcher):
    """Trusts the views' own poses; views without any go to the matcher it was built with.

    Features that agree with the known epipolar geometry tell the range of depths, plane sweep
    measures it.
    """

    class Settings(FeatureSettings, DepthSettings):
        working_size: int = Field(320, ge=64, le=1024)
        """long side at which depth is measured [pixels]: exact poses are worth a finer one"""
        planes: int = Field(128, ge=24, le=512)
        """most depth hypotheses a pixel"""
        matcher: PartChoice = PartChoice(name="classical")
        """what matches views without known poses"""
        threshold: float = Field(1.5, gt=0, le=20)
        """distance from the known epipolar line [pixels]"""
        refine_poses: bool = False
        """let the known poses move to where the photos' matches want them"""

    settings: Settings

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings, self.matcher = settings, matcher

    def _geometry(self, views: Views, corrected: Views) -> Geometry:
        if views.c2w is None:
            return _matched(self.matcher, views, corrected)
        poses = relative_to_first(views.c2w.detach().double().cpu())
        scenes = [
            self._match_scene(views, corrected, scene, poses[scene])
            for scene in range(len(views.images))
        ]
        parts = (torch.stack(field).to(views.images.device) for field in zip(*scenes))
        poses, depths, confidence, registered = parts
        return Geometry(poses.to(views.images), depths, confidence, registered)

    def _match_scene(
        self, views: Views, corrected: Views, scene: int, c2w: Float[Tensor, "view 4 4"]
    ) -> tuple[Tensor, ...]:
        """Poses, depths, confidence and which views have any, of one scene."""
        images = calibrated_images(views, scene)
        poses = tuple(Pose.from_matrix(matrix).inverse() for matrix in c2w.numpy())
        features = find_features(images, self.settings)
        if self.settings.refine_poses:
            poses = self._refined(images, features, poses)
            c2w = torch.from_numpy(np.stack([pose.inverse().matrix for pose in poses]))
        # Sampson's error counts the distances in both photos
        limit = self.settings.threshold / np.sqrt(2)
        registration = Registration.on_poses(
            images, features, dict(enumerate(poses)), limit
        )
        shown = images if corrected is views else calibrated_images(corrected, scene)
        maps = measure_depths(shown, registration, self.settings)
        inverse, confidence = (
            torch.from_numpy(part).to(views.images.dtype) for part in maps
        )
        return c2w, 1 / inverse, confidence, torch.from_numpy(registration.registered)

    def _refined(
        self,
        images: Sequence[CalibratedImage],
        features: FoundFeatures,
        poses: Sequence[Pose],
    ) -> tuple[Pose, ...]:
        """The poses settled on what the photos share; the first, and the unit of length, stay."""
        from edit3r_geometry.bundle_adjustment import adjust

        points = [keypoints.points for keypoints in features.keypoints]
        limit = max(images[0].size) / 256
        matches = {
            pair: view.indices
            for pair, view in agreeing_pairs(images, features, 1.0, 0)[0].items()
        }
        moved, _ = adjust(images, points, matches, dict(enumerate(poses)), 2 * limit)
        turns = [
            np.linalg.norm(cv2.Rodrigues(moved[v].rotation @ pose.rotation.T)[0])
            for v, pose in enumerate(poses)
        ]
        places = np.stack(
            [
                [pose.inverse().translation for pose in some]
                for some in (poses, moved.values())
            ]
        )
        steps = np.linalg.norm(places[1] - places[0], axis=1) / max(
            np.linalg.norm(places[0], axis=1).max(), 1e-12
        )
        reporting.say(
            "poses.refined",
            f"turned by up to {np.degrees(max(turns)):.2f} degrees, moved by up to "
            f"{max(steps):.1%} of the distance between the cameras",
        )
        return tuple(moved[view] for view in range(len(poses)))


class AutoMatcher(Matcher, MatchesCorrected):
    """Depth Anything 3 where its package is installed and its weights are at hand, base before
    small; else its part.

    What is picked becomes a setting, so that `run.json` tells it and answers of another pick are
    not reused.
    """

    class Settings(edit3r.Settings):
        pick: Literal["best", "da3-base", "da3-small", "part"] = "best"
        """'part': its matcher"""
        matcher: PartChoice = PartChoice(name="classical")
        """what matches where no network can"""

        @model_validator(mode="before")
        @classmethod
        def _decide(cls, values: Any) -> Any:
            best = isinstance(values, Mapping) and values.get("pick", "best") == "best"
            return {**values, "pick": best_at_hand()} if best else values

    settings: Settings

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings = settings
        self.matcher = (
            matcher
            if settings.pick == "part"
            else build("matcher", "da3", model=settings.pick)
        )

    def lens(self, views: Views) -> Lens | None:
        return self.matcher.lens(views)

    def match(self, views: Views) -> Geometry:
        return self.match_corrected(views, views)

    def match_corrected(self, views: Views, corrected: Views) -> Geometry:
        pick, name = self.settings.pick, component_name(self.matcher)
        reporting.say("matcher.picked", name if pick == "part" else f"{name} ({pick})")
        return _matched(self.matcher, views, corrected)


def _matched(matcher: Matcher, views: Views, corrected: Views) -> Geometry:
    """What a part says, with depth measured in one exposure where it can do that."""
    if isinstance(matcher, MatchesCorrected):
        return matcher.match_corrected(views, corrected)
    return matcher.match(views)


def best_at_hand() -> str:
    """The best weights of Depth Anything 3 that are ready here; 'part' without any."""
    usable = (
        name
        for name in ("da3-base", "da3-small")
        if default_registry().ready("matcher", "da3", name)
    )
    return next(usable, "part")


def _report(
    registration: Registration, features: FoundFeatures, names: Sequence[str]
) -> None:
    """Note the inliers of every pair and what matched them; warn of views that were left out."""
    helped = sum(bool(features.learned(a, b).any()) for a, b in features.indices)
    learned = (
        f" and, for {helped} of {len(features.indices)} pairs, {features.helper}"
        if helped
        else ""
    )
    tilted = ", of tilted images too" if features.tilted else ""
    reporting.note("matcher.matches", f"SIFT{learned}{tilted}")
    reporting.note(
        "matcher.inliers",
        {
            f"{names[a]} {names[b]}": len(p.matches)
            for (a, b), p in registration.pairs.items()
        },
    )
    lost = [name for name, placed in zip(names, registration.registered) if not placed]
    if lost:
        reporting.warn(
            f"{', '.join(lost)}: shares too few points with the other photos to be placed, so it "
            "is left out."
        )
