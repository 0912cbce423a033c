"""Pinhole cameras: pixel rays, projection, poses, intrinsics, which way is up, pixels with depths
as points or Gaussians.

Intrinsics are normalised (fx, cx in image widths, fy, cy in heights); points and vectors are kept
apart by name.
"""

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.geometry.harmonics import colour_to_dc


def intrinsics_from_fov(
    fov_x: float, image_size: tuple[int, int]
) -> Float[Tensor, "3 3"]:
    """Centred intrinsics with square pixels and a horizontal field of view `fov_x` [radians]."""
    height, width = image_size
    focal = 0.5 / math.tan(0.5 * fov_x)  # in widths
    return torch.tensor([[focal, 0, 0.5], [0, focal * width / height, 0.5], [0, 0, 1]])


def field_of_view(views: Views) -> float:
    """Of view 0, across its longer side [degrees]."""
    height, width = views.image_size
    focal = float(views.intrinsics[0, 0, 0, 0]) * width  # [pixels]
    return math.degrees(2 * math.atan(0.5 * max(height, width) / focal))


def to_pixels(
    intrinsics: Float[Tensor, "*batch 3 3"], image_size: tuple[int, int]
) -> Float[Tensor, "*batch 3 3"]:
    """Intrinsics in pixels, centre of the top-left pixel at (0.5, 0.5)."""
    height, width = image_size
    return intrinsics * intrinsics.new_tensor([width, height, 1])[:, None]


def from_pixels(
    intrinsics: Float[Tensor, "*batch 3 3"], image_size: tuple[int, int]
) -> Float[Tensor, "*batch 3 3"]:
    """Inverse of `to_pixels`."""
    height, width = image_size
    return intrinsics / intrinsics.new_tensor([width, height, 1])[:, None]


def pixel_grid(
    image_size: tuple[int, int], like: Tensor
) -> Float[Tensor, "height width 2"]:
    """Normalised (x, y) of every pixel centre, dtype and device of `like`."""
    height, width = image_size
    ys = (torch.arange(height, dtype=like.dtype, device=like.device) + 0.5) / height
    xs = (torch.arange(width, dtype=like.dtype, device=like.device) + 0.5) / width
    return torch.stack(torch.meshgrid(xs, ys, indexing="xy"), -1)


def pixel_rays(
    intrinsics: Float[Tensor, "*batch 3 3"], image_size: tuple[int, int]
) -> Float[Tensor, "*batch height width 3"]:
    """Camera-frame vectors through every pixel centre, z = 1 (so a point is `ray * depth`)."""
    grid = pixel_grid(image_size, intrinsics)
    homogeneous = torch.cat((grid, torch.ones_like(grid[..., :1])), -1)
    inverse = torch.linalg.inv(intrinsics.double()).to(intrinsics.dtype)
    return torch.einsum("...ij,hwj->...hwi", inverse, homogeneous)


def unproject(
    depths: Float[Tensor, "*batch height width"],
    intrinsics: Float[Tensor, "*batch 3 3"],
    c2w: Float[Tensor, "*batch 4 4"],
) -> Float[Tensor, "*batch height width 3"]:
    """World points of pixels at camera-z `depths`."""
    height, width = depths.shape[-2:]
    rays = pixel_rays(intrinsics, (height, width))
    return transform_points(c2w, rays * depths[..., None])


def transform_points(
    matrices: Float[Tensor, "*batch 4 4"],
    points: Float[Tensor, "*batch height width 3"],
) -> Float[Tensor, "*batch height width 3"]:
    """Apply rigid transforms to grids of points."""
    rotated = torch.einsum("...ij,...hwj->...hwi", matrices[..., :3, :3], points)
    return rotated + matrices[..., None, None, :3, 3]


def project(
    points: Float[Tensor, "*batch point 3"],
    intrinsics: Float[Tensor, "*batch 3 3"],
    c2w: Float[Tensor, "*batch 4 4"],
) -> tuple[Float[Tensor, "*batch point 2"], Float[Tensor, "*batch point"]]:
    """Normalised image coordinates and camera z of world points; only z > 0 means anything."""
    w2c = invert_rigid(c2w)
    camera = (
        torch.einsum("...ij,...nj->...ni", w2c[..., :3, :3], points)
        + w2c[..., None, :3, 3]
    )
    z = camera[..., 2]
    safe = torch.where(z.abs() > 1e-12, z, torch.full_like(z, 1e-12))
    image = torch.einsum("...ij,...nj->...ni", intrinsics, camera / safe[..., None])
    return image[..., :2], z


def project_to_pixels(
    points: Float[Tensor, "point 3"],
    intrinsics: Float[Tensor, "3 3"],
    c2w: Float[Tensor, "4 4"],
    image_size: tuple[int, int],
) -> tuple[Int[Tensor, "point"], Float[Tensor, "point"], Bool[Tensor, "point"]]:
    """Index of the pixel that shows each point, row by row; its camera z; whether it is in sight.

    The index of a point that is not in sight, beside the picture or behind the camera, means
    nothing.
    """
    height, width = image_size
    places, z = project(points, intrinsics, c2w)
    column, row = (
        (places * places.new_tensor([width, height])).floor().long().unbind(-1)
    )
    inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return row * width + column, z, inside


def invert_rigid(matrices: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Inverse of rigid transforms: c2w to w2c and back."""
    rotation = matrices[..., :3, :3].transpose(-1, -2)
    result = torch.zeros_like(matrices)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -torch.einsum(
        "...ij,...j->...i", rotation, matrices[..., :3, 3]
    )
    result[..., 3, 3] = 1
    return result


def relative_to_first(
    c2w: Float[Tensor, "batch view 4 4"],
) -> Float[Tensor, "batch view 4 4"]:
    """The same poses in the frame of view 0, whose own becomes exactly the identity."""
    result = invert_rigid(c2w[:, :1]) @ c2w
    result = result.clone()
    result[:, 0] = torch.eye(4, dtype=c2w.dtype, device=c2w.device)
    return result


def scale_poses(
    c2w: Float[Tensor, "*batch 4 4"], factor: float | Float[Tensor, "*factors"]
) -> Float[Tensor, "*batch 4 4"]:
    """The same poses in another unit: centres times `factor`, one or one for each scene."""
    scaled = c2w.clone()
    scaled[..., :3, 3] *= factor[..., None] if isinstance(factor, Tensor) else factor
    return scaled


def pixel_scales(
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    footprint: float,
) -> Float[Tensor, "batch view height width"]:
    """The length of `footprint` pixels, seen at each pixel's depth [unit of `depths`]."""
    focal = intrinsics[..., 0, 0] * depths.shape[-1]  # [pixels]
    return footprint * depths / focal[..., None, None]


def pixels_to_gaussians(
    images: Float[Tensor, "batch view 3 height width"],
    depths: Float[Tensor, "batch view height width"],
    cameras: Cameras,
    scales: Float[Tensor, "batch view height width"],
    opacities: Float[Tensor, "batch view height width"],
) -> Gaussians:
    """One round Gaussian at every pixel's depth, ordered view by view, then row by row.

    `depths` are camera z and `scales` standard deviations in the unit of the cameras' poses. Each
    Gaussian shows the colour of its pixel from every side (harmonics of degree 0). Differentiable.
    """
    batch, views, height, width = depths.shape
    count = views * height * width
    points = unproject(depths, cameras.intrinsics, cameras.c2w)
    quats = points.new_zeros(batch, count, 4)
    quats[..., 0] = 1
    return Gaussians(
        means=points.reshape(batch, count, 3),
        scales=scales.reshape(batch, count, 1).expand(-1, -1, 3).contiguous(),
        quats=quats,
        opacities=opacities.reshape(batch, count),
        harmonics=colour_to_dc(images.permute(0, 1, 3, 4, 2)).reshape(
            batch, count, 1, 3
        ),
        view_index=torch.arange(views, device=points.device).repeat_interleave(
            height * width
        ),
    )


TRUST_IN_MEAN = 0.03
"""How much the mean of the cameras' own ups counts beside their horizons. Chosen on sets of seven
scenes (docs/notes/scenes.md); it decides alone where all cameras face the same way."""

STEEP = 0.98
"""Cosine from which a camera looks straight up or down; a matter of definition."""


def quarter_turns(c2w: Float[Tensor, "view 4 4"]) -> Int[Tensor, "view"]:
    """Quarter turns, 0 to 3 anticlockwise, that bring each image the way round of most others."""
    ups = _ups_of_turned(c2w)
    agree = (ups[:, 0] @ ups[:, 0].T) > math.cos(math.radians(45))
    most = ups[agree.sum(1).argmax(), 0]
    return (ups @ most).argmax(1)


def up_direction(c2w: Float[Tensor, "view 4 4"]) -> Float[Tensor, "3"]:
    """The unit vector that points up, in the frame of the poses.

    People tilt a camera up and down, but hardly ever roll it. So the x axis of each image is level,
    and up is the direction most nearly at right angles to all of them (Brown and Lowe, Automatic
    Panoramic Image Stitching, IJCV 2007, section 5). Images taken on their side are turned first.
    """
    views = torch.arange(len(c2w), device=c2w.device)
    turns = quarter_turns(c2w)
    ups = _ups_of_turned(c2w)[views, turns]
    across = torch.linalg.cross(ups, c2w[:, :3, 2])
    mean = torch.nn.functional.normalize(ups.mean(0), dim=0)
    spread = across.T @ across / len(c2w) - TRUST_IN_MEAN * torch.outer(mean, mean)
    up = torch.linalg.eigh(spread).eigenvectors[:, 0]
    return up if up @ mean > 0 else -up


def upright(
    up: Float[Tensor, "3"], camera: Float[Tensor, "3 3"]
) -> Float[Tensor, "3 3"]:
    """The rotation after which `up` is -y, and the way that a camera (c2w) looks is ahead, in z."""
    down, ahead = -up, camera[:, 2]
    if (ahead @ up).abs() > STEEP:  # ahead is then where the top of the image is
        ahead = (ahead @ up).sign() * camera[:, 1]
    right = torch.nn.functional.normalize(torch.linalg.cross(down, ahead), dim=0)
    return torch.stack((right, down, torch.linalg.cross(right, down)))


def _ups_of_turned(c2w: Float[Tensor, "view 4 4"]) -> Float[Tensor, "view 4 3"]:
    """What is up in the scene once an image was turned by 0, 1, 2 and 3 quarters anticlockwise."""
    x, y = c2w[:, :3, 0], c2w[:, :3, 1]
    return torch.stack((-y, x, y, -x), 1)
