"""Contract of a matcher."""

import math

import torch

from edit3r.errors import MatchingError
from edit3r.geometry.rotations import rotation_angle
from edit3r.interfaces import MatchedGeometry, Matcher
from edit3r.testing.contract import Contract
from edit3r.testing.scenes import photograph
from edit3r.types import Views


class MatcherContract(Contract):
    """Poses in the frame of view 0, positive depths, confidences in [0, 1]; an easy scene is placed right."""

    kind = "matcher"
    subject: Matcher
    image_size: tuple[int, int] = (192, 256)  # (height, width) [pixels]
    max_angle: float = 0.1  # [radians] rotation error allowed on the easy scene

    def test_geometry_is_valid(self) -> None:
        views = photograph(3, self.image_size).views.to(self.device)
        geometry = self._match(views)
        height, width = views.image_size
        self.require_tensor("c2w", geometry.c2w, (1, 3, 4, 4))
        self.require_tensor("depths", geometry.depths, (1, 3, height, width))
        self.require_tensor("confidence", geometry.confidence, (1, 3, height, width))
        self.require_tensor("registered", geometry.registered, (1, 3), torch.bool)
        self.require(geometry.depths.min() > 0, "a depth is not positive; fill in where nothing matched.")
        self.require_range("confidence", geometry.confidence, 0, 1, "scale it; 0 means filled in")
        identity = torch.eye(4, device=self.device)
        fix = "express poses in the frame of view 0"
        self.require_equal("the pose of view 0 is not the identity", geometry.c2w[0, 0], identity, fix, 1e-5)
        self.require(geometry.registered[0, 0], "view 0 is not registered; everything is placed relative to it.")

    def test_an_easy_scene_is_placed_right(self) -> None:
        scene = photograph(2, self.image_size)
        geometry = self._match(scene.views.to(self.device))
        found, true = geometry.c2w[0, 1].cpu(), scene.cameras.c2w[0, 1]
        angle = rotation_angle(found[:3, :3], true[:3, :3]).item()
        limit = math.degrees(self.max_angle)
        self.require(
            angle < self.max_angle, f"the rotation is off by {math.degrees(angle):.1f} of {limit:.1f} degrees."
        )
        error, flat = (_depth_error(d, scene.depths[0, 0]) for d in (geometry.depths[0, 0].cpu(), torch.ones(1)))
        fix = "return camera z in the unit of the poses, not distance or disparity"
        self.require(error < 0.5 * flat, f"depths are off by {error:.0%}, a flat wall would be by {flat:.0%}; {fix}.")

    def test_photos_without_texture_raise_a_matching_error(self) -> None:
        views = photograph(2, self.image_size).views.to(self.device)
        try:
            self.subject.match(Views(torch.full_like(views.images, 0.5), views.intrinsics))
        except MatchingError:
            return
        except Exception as error:
            self.require(
                False, f"grey photos raised {type(error).__name__}: {error}; raise edit3r.errors.MatchingError."
            )
        self.require(False, "grey photos were matched; raise edit3r.errors.MatchingError instead of inventing a pose.")

    def _match(self, views: Views) -> MatchedGeometry:
        geometry = self.call("match()", self.subject.match, views)
        found = type(geometry).__name__
        self.require(isinstance(geometry, MatchedGeometry), f"match() returned a {found}; return MatchedGeometry.")
        return geometry


def _depth_error(depths: torch.Tensor, true: torch.Tensor) -> float:
    """Mean relative error after the best common scale; an outlier counts as at most 100 %."""
    ratio = depths / true
    return (ratio / ratio.median() - 1).abs().clamp(max=1).mean().item()
