"""The unit of length that a run with given poses works in, and lengths that somebody knows.

Camera files come in millimetres, kilometres or anything else; what follows (near planes, step
sizes, prices) is made for scenes of ordinary size. So `read` brings the photos into a unit in which
the cameras stand about 1 apart, and the result answers in the given one. Each scene of a batch has
a unit of its own. The factor is a power of two: it changes no other bit.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.kit.geometry.cameras import relative_to_first, scale_poses

Point = tuple[str, float, float]
"""Name of a view, x and y [shares of the view]."""
SAME_POSE = 1e-3
"""Most by which poses that were taken over differ from those that were given [mean distances]."""
# factor of a unit; positions have limits of their own; a sanity limit
LARGEST = 2.0**100


@dataclass(frozen=True)
class KnownLength:
    """Two places, and how far apart they are."""

    text: str  # as it was given
    ends: tuple[Point, Point]
    metres: float


@dataclass(frozen=True)
class Unit:
    """What the lengths of each scene are multiplied by."""

    factor: Float[Tensor, "batch"]

    @property
    def back(self) -> "Unit":
        """The way back."""
        return Unit(1 / self.factor)

    def times(self, factor: float) -> "Unit":
        """The same with all lengths multiplied by `factor`, too."""
        return Unit(self.factor * factor)

    def where(self, scenes: Bool[Tensor, "batch"]) -> "Unit":
        """The same for these scenes; the others keep their lengths."""
        return Unit(torch.where(scenes, self.factor, 1.0))

    def views(self, views: Views) -> Views:
        if views.c2w is None:
            return views
        return replace(views, c2w=self._poses(views.c2w))

    def cameras(self, cameras: Cameras) -> Cameras:
        return replace(cameras, c2w=self._poses(cameras.c2w))

    def gaussians(self, gaussians: Gaussians) -> Gaussians:
        means, scales = self._times(gaussians.means), self._times(gaussians.scales)
        return replace(gaussians, means=means, scales=scales)

    def rendering(self, rendering: Rendering) -> Rendering:
        depths = rendering.depths
        return replace(
            rendering, depths=None if depths is None else self._times(depths)
        )

    def reconstruction(self, scene: Reconstruction) -> Reconstruction:
        cameras = None if scene.cameras is None else self.cameras(scene.cameras)
        return replace(
            scene, gaussians=self.gaussians(scene.gaussians), cameras=cameras
        )

    def _poses(
        self, c2w: Float[Tensor, "batch view 4 4"]
    ) -> Float[Tensor, "batch view 4 4"]:
        return scale_poses(c2w, self.factor.to(c2w)[:, None])

    def _times(self, lengths: Tensor) -> Tensor:
        factor = self.factor.to(lengths)
        return lengths * factor.view(-1, *[1] * (lengths.ndim - 1))


GIVEN = Unit(torch.ones(1, dtype=torch.float64))


def own_unit(views: Views) -> Unit:
    """Of each scene, the power of two that brings the cameras' mean distance from the first nearest
    to 1; in float64, on the CPU.
    """
    if views.c2w is None:
        return Unit(torch.ones(len(views.images), dtype=torch.float64))
    distances = _mean_distances(relative_to_first(views.c2w.cpu().double()))
    known = (distances > 0) & distances.isfinite()
    nearest = torch.exp2(-distances.log2().round()).clamp(1 / LARGEST, LARGEST)
    return Unit(torch.where(known, nearest, 1.0))


def unit_of_scene(
    scene: Reconstruction, photos: Views, unit: Unit, refine_poses: bool
) -> Unit:
    """What brings a scene that was made in `unit` back into the unit of the given poses, if it was
    made on those, or from them (`refine_poses`).
    """
    return unit.back.where(has_given_poses(scene, photos) | refine_poses)


def has_given_poses(scene: Reconstruction, views: Views) -> Bool[Tensor, "batch"]:
    """Which scenes of a reconstruction stand on the views' own poses, in their unit.

    A reconstructor that looks for poses by itself has a unit of its own, which stays.
    """
    if scene.cameras is None or views.c2w is None:
        return torch.zeros(len(views.images), dtype=torch.bool)
    given = relative_to_first(views.c2w.cpu().double())
    poses = scene.cameras.c2w.cpu().double()
    if given.shape != poses.shape:
        return torch.zeros(len(views.images), dtype=torch.bool)
    apart = (poses - given).abs()
    distances = _mean_distances(given).clamp(min=1e-30)
    apart[..., :3, 3] /= distances[:, None, None]
    return (apart <= SAME_POSE).flatten(1).all(1)


def _mean_distances(c2w: Float[Tensor, "batch view 4 4"]) -> Float[Tensor, "batch"]:
    """Of the other cameras from the first, which stands at the origin; 0 without others."""
    distances = c2w[:, 1:, :3, 3].norm(dim=-1)
    return distances.sum(1) / max(distances.shape[1], 1)
