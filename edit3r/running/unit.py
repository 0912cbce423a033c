"""The unit of length that a run with given poses works in, and what somebody knows of lengths and
heights.

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
from edit3r.kit.geometry.cameras import relative_to_first, scale_poses, upright
from edit3r.kit.scenes.axes import rotated

Point = tuple[str, float, float]
"""Name of a view, x and y [shares of the view]."""
Direction = tuple[float, float, float]
"""A unit vector in the frame of view 0."""
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
class KnownLevel:
    """Three places that lie at one height; without them, how the photos were held tells it."""

    text: str  # as it was given
    places: tuple[Point, ...] = ()


@dataclass(frozen=True)
class Unit:
    """What the lengths of each scene are multiplied by, and how it is turned about view 0."""

    factor: Float[Tensor, "batch"]
    # of the scene; poses of photos are not turned
    turn: Float[Tensor, "3 3"] | None = None

    @property
    def inverse(self) -> "Unit":
        """The way back."""
        return Unit(1 / self.factor, None if self.turn is None else self.turn.T)

    def times(self, factor: float) -> "Unit":
        """The same with all lengths multiplied by `factor`, too."""
        return replace(self, factor=self.factor * factor)

    def upright(self, up: Direction | None) -> "Unit":
        """The same with the scene turned so that `up` is -y; None: as it stands."""
        if up is None:
            return self
        eye = torch.eye(3, dtype=torch.float64)
        return replace(self, turn=upright(eye.new_tensor(up), eye))

    def where(self, scenes: Bool[Tensor, "batch"]) -> "Unit":
        """The same for these scenes; the others keep their lengths."""
        return replace(self, factor=torch.where(scenes, self.factor, 1.0))

    def views(self, views: Views) -> Views:
        """Photos with their poses scaled, and never turned."""
        if views.c2w is None:
            return views
        return replace(views, c2w=self._poses(views.c2w))

    def cameras(self, cameras: Cameras) -> Cameras:
        """Cameras of the scene: their poses scaled and turned with it."""
        c2w = self._poses(cameras.c2w)
        if self.turn is not None:
            c2w[..., :3, :] = self.turn.to(c2w) @ c2w[..., :3, :]
        return replace(cameras, c2w=c2w)

    def gaussians(self, gaussians: Gaussians) -> Gaussians:
        """The scene scaled and turned."""
        means, scales = self._scaled(gaussians.means), self._scaled(gaussians.scales)
        scaled = replace(gaussians, means=means, scales=scales)
        return scaled if self.turn is None else rotated(scaled, self.turn)

    def rendering(self, rendering: Rendering) -> Rendering:
        """Pictures of the scene, their depths scaled."""
        depths = rendering.depths
        return replace(
            rendering, depths=None if depths is None else self._scaled(depths)
        )

    def reconstruction(self, scene: Reconstruction) -> Reconstruction:
        """The scene and its cameras, scaled and turned together."""
        cameras = None if scene.cameras is None else self.cameras(scene.cameras)
        return replace(
            scene, gaussians=self.gaussians(scene.gaussians), cameras=cameras
        )

    def _poses(
        self, c2w: Float[Tensor, "batch view 4 4"]
    ) -> Float[Tensor, "batch view 4 4"]:
        return scale_poses(c2w, self.factor.to(c2w)[:, None])

    def _scaled(self, lengths: Tensor) -> Tensor:
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
    return unit.inverse.where(has_given_poses(scene, photos) | refine_poses)


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
