"""A scene as photos: places around it or within it, which way is up, and pictures from there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import FindsGeometry, Geometry, Rasterizer
from edit3r.contract.types import Cameras, Gaussians, GivenScene, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov, invert_rigid, up_direction
from edit3r.kit.geometry.rotations import quats_to_matrices
from edit3r.kit.rendering import render_each
from edit3r.kit.scenes.axes import LEAST_OPACITY, rotated

BACKGROUND = 0.5
"""Grey behind a scene in its pictures: black things stand out from it as white ones do."""
UPS = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
# The numbers of this block: no figures kept.
AROUND = 50.0  # horizontal field of view of places around a thing [degrees]
WITHIN = 75.0  # and of those in a room
DISTANCE = 2.5  # of places around a thing [radii of the thing]
CORE = 0.98  # share of the Gaussians that a radius takes in
HEIGHTS = (0.25, 0.7)  # of places around a thing above its middle, by turns [radii]
COVERED = 0.9  # alpha of what is seen all around from within a room
ROOMY = 0.25  # nearest tenth of the depths around the middle of a room [radii]
FREE = 0.3  # depth under which something stands in the way [of what is expected]
CLOSER = 0.75  # by which a place comes closer where something stands in the way
TRIES = 6
LEVEL = 0.9  # cosine under which a surface is not level
FLOOR = 0.12  # share of the area of all surfaces that a floor has, at least
SLAB = 0.1  # thickness of what counts as floor [extents of the scene]
SOLID = 0.5  # alpha from which a pixel has a depth
FAR = 1.5  # depth of the background [farthest depths]
MOST = 200_000  # Gaussians that places are chosen by


@dataclass(frozen=True)
class Places:
    """Where a scene is looked at from, in its own frame."""

    cameras: Cameras  # batch 1
    names: tuple[str, ...]
    up: tuple[float, float, float]
    how: str  # "around", "within" or "given"


@dataclass(frozen=True)
class SceneViews:
    """Pictures of a scene in the frame of view 0, and the way back into its own."""

    pictures: Views  # over `BACKGROUND`
    scene: GivenScene
    c2w: Float[Tensor, "4 4"]  # of view 0 in the scene's own frame
    unit: float  # of the scene's own lengths, one of the pictures' frame


def look_around(
    gaussians: Gaussians,
    rasterizer: Rasterizer,
    *,
    count: int,
    size: tuple[int, int],
    up: str | None = None,
) -> Places:
    """`count` places from which a scene (batch 1) is seen from all sides, first one in front.

    A room is looked at from its middle, all else from around it. `up` is one of `UPS`; None: as the
    scene's floor tells, else -y, as most programs have it. Raises InputError for a scene whose
    middle is empty.
    """
    core = _core(gaussians)
    upward = torch.tensor(UPS[up] if up else up_of(core))
    points = core.means[0]
    low, high = points.quantile(torch.tensor([0.01, 0.99]), 0)
    centre = (low + high) / 2
    radius = float((points - centre).norm(dim=1).quantile(CORE))
    if not radius > 0:
        raise InputError("the scene is a single point, and cannot be looked around in.")
    if _is_room(core, centre, radius, upward, rasterizer):
        poses = torch.stack(
            [_pose(centre, _turned(upward, k / count), upward) for k in range(count)]
        )
        cameras, how = _cameras(poses, size, WITHIN), "within"
    else:
        poses = torch.stack(
            [
                _free_place(
                    core, centre, radius, k / count, HEIGHTS[k % 2], upward, rasterizer
                )
                for k in range(count)
            ]
        )
        cameras, how = _cameras(poses, size, AROUND), "around"
    names = tuple(f"place_{k + 1}" for k in range(count))
    return Places(cameras, names, (*upward.tolist(),), how)


def pictures_of(
    gaussians: Gaussians, places: Places, rasterizer: Rasterizer
) -> SceneViews:
    """The scene as it is seen from its places.

    Everything comes into the frame of view 0 and into a unit (a power of two) in which what is seen
    lies about 1 away. Raises InputError where the places show nothing.
    """
    first = places.cameras.c2w[0, 0]
    rendered = render_each(rasterizer, gaussians, places.cameras, "look at the scene")
    depths, alphas = rendered.depths[:, :, 0], rendered.alphas[:, :, 0]
    seen = alphas > 0.5
    if not bool(seen.any()):
        raise InputError(
            "nothing of the scene is seen from its cameras; give cameras of this scene, or none."
        )
    unit = float(torch.exp2(depths[seen].median().log2().round()))
    images = over_background(rendered.images, rendered.alphas)
    to_first = invert_rigid(first[None])[0]
    moved = rotated(gaussians, to_first[:3, :3])
    moved = replace(
        moved,
        means=(moved.means + to_first[:3, 3].to(moved.means)) / unit,
        scales=moved.scales / unit,
    )
    c2w = to_first @ places.cameras.c2w
    c2w[:, 0] = torch.eye(4)
    c2w[..., :3, 3] /= unit
    cameras = replace(places.cameras, c2w=c2w)
    pictures = Views(images, cameras.intrinsics, places.names)
    scene = GivenScene(moved, cameras, images, BACKGROUND, depths / unit, alphas)
    return SceneViews(pictures, scene, first, unit)


class SceneGeometry(FindsGeometry):
    """The geometry of a given scene, whatever its pictures show after an edit."""

    def __init__(self, scene: GivenScene) -> None:
        self.scene = scene

    def find_geometry(self, views: Views) -> Geometry:
        """Exact where the scene covers a pixel; behind it all where it does not."""
        scene = self.scene
        solid = scene.alphas > SOLID
        far = FAR * scene.depths[solid].max()
        return Geometry(
            scene.cameras.c2w,
            torch.where(solid, scene.depths, far),
            solid.to(scene.depths),
            torch.ones(scene.cameras.c2w.shape[:2], dtype=torch.bool),
        )


def over_background(
    images: Float[Tensor, "*batch 3 height width"],
    alphas: Float[Tensor, "*batch 1 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """Pictures, rendered over black, over `BACKGROUND`, in [0, 1]."""
    return (images + (1 - alphas) * BACKGROUND).clamp(0, 1)


def up_of(gaussians: Gaussians) -> tuple[float, float, float]:
    """The axis of a scene (batch 1) that points up from its floor; -y where it has none.

    A floor is a level surface with much area at one end of the scene, with little below.
    """
    points, scales = gaussians.means[0], gaussians.scales[0]
    area = gaussians.opacities[0] * scales.prod(1) / scales.amin(1).clamp(min=1e-12)
    axes = quats_to_matrices(gaussians.quats[0])
    thin = scales.argmin(1)
    normals = axes[torch.arange(len(axes)), :, thin]
    best, share_of_best = UPS["-y"], FLOOR
    for up in UPS.values():
        direction = torch.tensor(up)
        heights = points @ direction
        low, high = heights.quantile(torch.tensor([0.02, 0.98]))
        slab = heights < low + SLAB * (high - low)
        level = (normals @ direction).abs() > LEVEL
        share = float(area[slab & level].sum() / area.sum())
        opposite = heights > high - SLAB * (high - low)
        if share > share_of_best and share > 2 * float(
            area[opposite & level].sum() / area.sum()
        ):
            best, share_of_best = up, share
    return best


def _core(gaussians: Gaussians) -> Gaussians:
    """At most `MOST` of the Gaussians that can be seen, evenly taken."""
    drawn = (gaussians.opacities[0] >= LEAST_OPACITY).nonzero()[:, 0]
    step = len(drawn) // MOST + 1
    core = gaussians.select(drawn[::step])
    return replace(core, scales=core.scales * step**0.5)


def _turned(up: Float[Tensor, "3"], turn: float) -> Float[Tensor, "3"]:
    """A level unit vector, `turn` of a full turn about `up` from the first one."""
    # The first looks along z, the way most cameras do, where up allows it.
    ahead = torch.eye(3)[2 if up[2].abs() < 0.5 else 1]
    ahead = torch.nn.functional.normalize(ahead - (ahead @ up) * up, dim=0)
    angle = 2 * math.pi * turn
    return math.cos(angle) * ahead + math.sin(angle) * torch.linalg.cross(up, ahead)


def _pose(
    eye: Float[Tensor, "3"], forward: Float[Tensor, "3"], up: Float[Tensor, "3"]
) -> Float[Tensor, "4 4"]:
    """c2w of a camera at `eye` that looks `forward`, held upright."""
    forward = torch.nn.functional.normalize(forward, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack((right, torch.linalg.cross(forward, right), forward), 1)
    pose[:3, 3] = eye
    return pose


def _cameras(
    poses: Float[Tensor, "camera 4 4"], size: tuple[int, int], fov: float
) -> Cameras:
    lens = intrinsics_from_fov(math.radians(fov), size).expand(1, len(poses), 3, 3)
    return Cameras(poses[None], lens.clone(), size)


def _free_place(
    core: Gaussians,
    centre: Float[Tensor, "3"],
    radius: float,
    turn: float,
    height: float,
    up: Float[Tensor, "3"],
    rasterizer: Rasterizer,
) -> Float[Tensor, "4 4"]:
    """A place that looks at the middle, as far away as nothing stands before it."""
    distance = DISTANCE
    for _ in range(TRIES):
        away = distance * -_turned(up, turn) + height * distance / DISTANCE * up
        pose = _pose(centre + radius * away, -away, up)
        camera = _cameras(pose[None], (32, 32), AROUND)
        shown = rasterizer.render(core, camera)
        near = shown.depths[0, 0, 0][shown.alphas[0, 0, 0] > 0.5]
        expected = radius * float(away.norm())
        if near.numel() == 0 or float(near.quantile(0.2)) > FREE * expected:
            return pose
        distance *= CLOSER
    return pose


def _is_room(
    core: Gaussians,
    centre: Float[Tensor, "3"],
    radius: float,
    up: Float[Tensor, "3"],
    rasterizer: Rasterizer,
) -> bool:
    """Whether the middle is free, and surfaces are seen from it all around."""
    poses = [_pose(centre, _turned(up, k / 4), up) for k in range(4)]
    cameras = _cameras(torch.stack(poses), (24, 24), 90.0)
    shown = rasterizer.render(core, cameras)
    depths, alphas = shown.depths[0, :, 0], shown.alphas[0, :, 0]
    if float(alphas.mean((1, 2)).amin()) < COVERED:
        return False
    return float(depths.flatten().quantile(0.1)) > ROOMY * radius


def as_given(cameras: Cameras, names: Sequence[str]) -> Places:
    """Places that somebody knows."""
    up = up_direction(cameras.c2w[0])
    return Places(cameras, tuple(names), (*up.tolist(),), "given")
