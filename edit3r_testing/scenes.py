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

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.geometry.cameras import intrinsics_from_fov, pixel_rays
from edit3r.kit.geometry.harmonics import colour_to_dc

FOV_X = 0.9  # [radians]
# between neighbouring cameras [scene units]; the wall is about 3.5 away
BASELINE = 0.22
# x, y, z, radius [scene units]
BALLS = torch.tensor([[-0.55, 0.15, 2.2, 0.45], [0.6, -0.2, 2.7, 0.5]])
SUPERSAMPLING = 2  # rays per pixel side, against aliasing


@dataclass(frozen=True)
class Photographed:
    """Photos of B scenes with what was true when they were taken."""

    views: Views
    cameras: Cameras  # view 0 at the identity
    depths: Float[Tensor, "batch view height width"]  # camera z
    objects: Float[Tensor, "object batch view height width"]  # 1 where a ball is seen

    def to(self, device: torch.device) -> "Photographed":
        return Photographed(
            self.views.to(device),
            self.cameras.to(device),
            self.depths.to(device),
            self.objects.to(device),
        )


def photograph(
    view_count: int = 2,
    image_size: tuple[int, int] = (48, 64),
    batch: int = 1,
    seed: int = 0,
) -> Photographed:
    """Photos of `batch` scenes that differ in texture, from cameras on a slightly curved line."""
    scene = _photographed(view_count, tuple(image_size), batch, seed)
    return deepcopy(scene)  # whoever gets it may write into it


def true_geometry(views: Views) -> Geometry:
    """What a matcher that makes no errors reads from photos of `photograph`, or edits of them."""
    batch, count = views.images.shape[:2]
    truth = photograph(count, views.image_size, batch).to(views.images.device)
    confidence = torch.ones_like(truth.depths)
    registered = confidence[:, :, 0, 0] > 0
    return Geometry(truth.cameras.c2w, truth.depths, confidence, registered)


@lru_cache(maxsize=32)
def _photographed(
    view_count: int, image_size: tuple[int, int], batch: int, seed: int
) -> Photographed:
    height, width = image_size
    cameras = cameras_around(view_count, image_size, batch)
    fine = (height * SUPERSAMPLING, width * SUPERSAMPLING)
    rays = pixel_rays(cameras.intrinsics[0, 0], fine)
    points, depths, hit = _cast(cameras.c2w[0], rays)
    images = []
    for item in range(batch):
        texture = _solid_texture(points, hit, seed + item)
        images.append(F.avg_pool2d(texture, SUPERSAMPLING))
    middle = slice(SUPERSAMPLING // 2, None, SUPERSAMPLING)
    objects = hit == torch.arange(1, len(BALLS) + 1)[:, None, None, None]
    depths = depths[:, middle, middle]
    objects = objects[:, None, :, middle, middle]
    return Photographed(
        views=Views(torch.stack(images).clamp(0, 1), cameras.intrinsics.clone()),
        cameras=cameras,
        depths=depths.repeat(batch, 1, 1, 1),
        objects=objects.repeat(1, batch, 1, 1, 1).float(),
    )


def _pose(view: int) -> Float[Tensor, "4 4"]:
    """Camera `view`: shifted to the right and turned towards the scene's middle."""
    angle = torch.tensor(-0.05 * view)
    cos, sin = angle.cos(), angle.sin()
    rows = [
        [cos, 0, sin, BASELINE * view],
        [0, 1, 0, 0.03 * view],
        [-sin, 0, cos, 0],
        [0, 0, 0, 1],
    ]
    return torch.tensor(rows)


def _cast(
    c2w: Float[Tensor, "view 4 4"], rays: Float[Tensor, "height width 3"]
) -> tuple[
    Float[Tensor, "view height width 3"],
    Float[Tensor, "view height width"],
    Int[Tensor, "view height width"],
]:
    """Where each ray first hits: points, camera z, and what it hits (0: the wall, else a ball)."""
    directions = torch.einsum("vij,hwj->vhwi", c2w[:, :3, :3], rays)
    origins = c2w[:, None, None, :3, 3].expand_as(directions)
    normal = torch.tensor([0.25, 0.1, 1.0])
    depths = [(3.5 - origins @ normal) / (directions @ normal)]
    for *centre, radius in BALLS:
        offset = origins - torch.stack(centre)
        # The smaller root t of |offset + t * direction| = radius.
        a = directions.square().sum(-1)
        b = (offset * directions).sum(-1)
        c = offset.square().sum(-1) - radius**2
        discriminant = b.square() - a * c
        near = (-b - discriminant.clamp(min=0).sqrt()) / a
        depths.append(near.masked_fill(discriminant <= 0, torch.inf))
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

    def uniform(*shape: int, low: float, high: float) -> Tensor:
        values = torch.rand(*shape, generator=generator, dtype=torch.float64)
        return (values * (high - low) + low).to(dtype)

    sideways = uniform(batch, count, 2, low=-1.0, high=1.0)
    depths = uniform(batch, count, 1, low=2.0, high=4.0)
    scales = uniform(batch, count, 3, low=-3.5, high=-1.2).exp()
    quats = torch.randn(batch, count, 4, generator=generator, dtype=torch.float64)
    return Gaussians(
        means=torch.cat((sideways, depths), -1),
        scales=scales,
        quats=F.normalize(quats.to(dtype), dim=-1),
        opacities=uniform(batch, count, low=0.05, high=0.95),
        harmonics=uniform(batch, count, (degree + 1) ** 2, 3, low=-0.6, high=0.6),
    )


def balls(
    means: Float[Tensor, "batch gaussian 3"],
    colours: Tensor | float = 0.5,
    *,
    size: float = 0.1,
    opacity: float = 0.9,
    harmonics: Tensor | None = None,
    view_index: Tensor | None = None,
) -> Gaussians:
    """Round Gaussians of one size and opacity, in plain sRGB `colours` or with `harmonics`."""
    if harmonics is None:
        plain = torch.as_tensor(colours).to(means).expand_as(means)
        harmonics = colour_to_dc(plain)[:, :, None]
    quats = means.new_tensor([1.0, 0, 0, 0]).repeat(*means.shape[:2], 1)
    opacities = torch.full_like(means[..., 0], opacity)
    scales = torch.full_like(means, size)
    return Gaussians(means, scales, quats, opacities, harmonics, view_index)


def cameras_around(
    camera_count: int = 2,
    image_size: tuple[int, int] = (24, 32),
    batch: int = 1,
    dtype: torch.dtype = torch.float32,
) -> Cameras:
    """Cameras along the line of `photograph`, looking at the clouds."""
    c2w = torch.stack([_pose(camera) for camera in range(camera_count)])
    intrinsics = intrinsics_from_fov(FOV_X, image_size)
    return Cameras(
        c2w.to(dtype).repeat(batch, 1, 1, 1),
        intrinsics.to(dtype).repeat(batch, camera_count, 1, 1),
        image_size,
    )
