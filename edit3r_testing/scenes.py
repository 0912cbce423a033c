"""Small inputs made by formula: a textured scene photographed from known poses, and clouds of
Gaussians.

The scene is a slanted wall behind two balls, all with a solid texture, so corresponding pixels show
the same colour and the true depth of every pixel is known. Everything is computed on the CPU from a
seed.
"""

from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.geometry.cameras import intrinsics_from_fov, pixel_rays

FOV_X = 0.9  # [radians]
BASELINE = (
    0.22  # between neighbouring cameras [scene units]; the wall is about 3.5 away
)
BALLS = (
    (-0.55, 0.15, 2.2, 0.45),
    (0.6, -0.2, 2.7, 0.5),
)  # x, y, z, radius [scene units]
SUPERSAMPLING = 2  # rays per pixel side, against aliasing


@dataclass(frozen=True)
class Photographed:
    """Photos of B scenes with what was true when they were taken."""

    views: Views
    cameras: Cameras  # view 0 at the identity
    depths: Float[Tensor, "batch view height width"]  # camera z
    objects: Float[Tensor, "object batch view height width"]  # 1 where a ball is seen


def photograph(
    view_count: int = 2,
    image_size: tuple[int, int] = (48, 64),
    batch: int = 1,
    seed: int = 0,
) -> Photographed:
    """Photos of `batch` scenes that differ in texture, from cameras along a slightly curved
    line.
    """
    return deepcopy(
        _photographed(view_count, tuple(image_size), batch, seed)
    )  # whoever gets them may write into them


@lru_cache(maxsize=32)
def _photographed(
    view_count: int, image_size: tuple[int, int], batch: int, seed: int
) -> Photographed:
    height, width = image_size
    fine = (height * SUPERSAMPLING, width * SUPERSAMPLING)
    intrinsics = intrinsics_from_fov(FOV_X, image_size)
    c2w = torch.stack([_pose(view) for view in range(view_count)])
    points, depths, hit = _cast(c2w, pixel_rays(intrinsics, fine))
    images = torch.stack(
        [_solid_texture(points, hit, seed + item) for item in range(batch)]
    )
    images = F.avg_pool2d(images.flatten(0, 1), SUPERSAMPLING).unflatten(
        0, (batch, view_count)
    )
    middle = SUPERSAMPLING // 2
    objects = torch.stack([hit == ball + 1 for ball in range(len(BALLS))])[
        ..., middle::SUPERSAMPLING, middle::SUPERSAMPLING
    ]
    poses, lenses = (
        c2w.expand(batch, -1, -1, -1),
        intrinsics.expand(batch, view_count, 3, 3),
    )
    return Photographed(
        views=Views(images.clamp(0, 1), lenses.clone()),
        cameras=Cameras(poses.clone(), lenses.clone(), image_size),
        depths=depths[:, middle::SUPERSAMPLING, middle::SUPERSAMPLING]
        .expand(batch, -1, -1, -1)
        .clone(),
        objects=objects[:, None].expand(-1, batch, -1, -1, -1).float(),
    )


def _pose(view: int) -> Float[Tensor, "4 4"]:
    """Camera `view`: shifted to the right and turned towards the scene's middle."""
    angle = torch.tensor(-0.05 * view)
    pose = torch.eye(4)
    pose[0, 0], pose[0, 2] = angle.cos(), angle.sin()
    pose[2, 0], pose[2, 2] = -angle.sin(), angle.cos()
    pose[:3, 3] = torch.tensor([BASELINE * view, 0.03 * view, 0.0])
    return pose


def _cast(
    c2w: Float[Tensor, "view 4 4"], rays: Float[Tensor, "height width 3"]
) -> tuple[
    Float[Tensor, "view height width 3"],
    Float[Tensor, "view height width"],
    Int[Tensor, "view height width"],
]:
    """Where each ray first hits: world points, camera z, and what it hits (0 the wall, 1 and 2 the
    balls).
    """
    directions = torch.einsum("vij,hwj->vhwi", c2w[:, :3, :3], rays)
    origins = c2w[:, None, None, :3, 3].expand_as(directions)
    normal = torch.tensor([0.25, 0.1, 1.0])
    depths = [(3.5 - origins @ normal) / (directions @ normal)]
    for x, y, z, radius in BALLS:
        offset = origins - torch.tensor([x, y, z])
        a, b = directions.square().sum(-1), (offset * directions).sum(-1)
        inside = b.square() - a * (offset.square().sum(-1) - radius**2)
        near = (-b - inside.clamp(min=0).sqrt()) / a
        depths.append(torch.where(inside > 0, near, torch.full_like(near, torch.inf)))
    depth, hit = torch.stack(depths).min(0)
    return origins + directions * depth[..., None], depth, hit


def _solid_texture(
    points: Float[Tensor, "view height width 3"],
    hit: Int[Tensor, "view height width"],
    seed: int,
) -> Float[Tensor, "view 3 height width"]:
    """Colours of points: three octaves of smooth noise filling space, tinted by what was hit."""
    generator = torch.Generator().manual_seed(seed)
    colours = torch.zeros(*points.shape[:-1], 3)
    for frequency, strength in ((1.2, 0.5), (3.5, 0.9), (9.0, 0.6)):
        volume = torch.rand(1, 3, 24, 24, 24, generator=generator) - 0.5
        grid = (points * frequency / 12)[None]
        sampled = F.grid_sample(
            volume, grid, padding_mode="reflection", align_corners=False
        )
        colours = colours + strength * sampled[0].movedim(0, -1)
    tints = torch.rand(len(BALLS) + 1, 3, generator=generator) * 0.5 + 0.25
    return (tints[hit] + 0.5 * colours).clamp(0, 1).movedim(-1, 1)


def gaussian_cloud(
    count: int = 60,
    batch: int = 1,
    degree: int = 1,
    seed: int = 0,
    dtype: torch.dtype = torch.float32,
) -> Gaussians:
    """Gaussians of mixed size and shape in front of the cameras of `cameras_around`."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return (
            torch.rand(*shape, generator=generator, dtype=torch.float64) * (high - low)
            + low
        ).to(dtype)

    means = torch.cat(
        (
            uniform(batch, count, 2, low=-1.0, high=1.0),
            uniform(batch, count, 1, low=2.0, high=4.0),
        ),
        -1,
    )
    scales = uniform(batch, count, 3, low=-3.5, high=-1.2).exp()
    quats = torch.randn(batch, count, 4, generator=generator, dtype=torch.float64).to(
        dtype
    )
    opacities = uniform(batch, count, low=0.05, high=0.95)
    harmonics = uniform(batch, count, (degree + 1) ** 2, 3, low=-0.6, high=0.6)
    return Gaussians(
        means, scales, quats / quats.norm(dim=-1, keepdim=True), opacities, harmonics
    )


def cameras_around(
    camera_count: int = 2,
    image_size: tuple[int, int] = (24, 32),
    batch: int = 1,
    dtype: torch.dtype = torch.float32,
) -> Cameras:
    """Cameras along the line of `photograph`, looking at the clouds."""
    c2w = torch.stack([_pose(camera) for camera in range(camera_count)]).expand(
        batch, -1, -1, -1
    )
    intrinsics = intrinsics_from_fov(FOV_X, image_size).expand(
        batch, camera_count, 3, 3
    )
    return Cameras(c2w.to(dtype).clone(), intrinsics.to(dtype).clone(), image_size)
