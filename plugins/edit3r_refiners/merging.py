"""Where Gaussians lie on the views, which of them show a surface twice, and one Gaussian in place
of a group.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.rotations import covariances, matrices_to_quats

Region = Bool[Tensor, "view height width"]

# The numbers of this block: no figures kept.
SAME_DEPTH = 0.02  # relative difference up to which two views show the same surface
SPREAD = 1.75  # size of a merged Gaussian against the moments of its cell
BEHIND = 0.25  # how far one moves away from its camera [its largest scale]
FAR_OUTSIDE = 1e6  # positions are clamped to this [pixels]
OPAQUE = 0.5
# an earlier view may show the surface with pixels this much larger; no figure kept
AS_FINE = 1.25
AROUND = tuple((dy, dx) for dy in (0, -1, 1) for dx in (0, -1, 1))
LEAST_WEIGHT = 1e-4  # transparent Gaussians still have a position


@dataclass(frozen=True)
class Placement:
    """Pixel, depth and pixel size of each Gaussian of one scene in the view it belongs to."""

    view: Int[Tensor, "gaussian"]
    # [pixels], pixel centres at +0.5; may lie outside the image
    x: Float[Tensor, "gaussian"]
    y: Float[Tensor, "gaussian"]
    depth: Float[Tensor, "gaussian"]  # camera z; behind the camera where <= 0
    pixel_size: Float[Tensor, "gaussian"]  # of a pixel at that depth [scene units]

    @property
    def column(self) -> Int[Tensor, "gaussian"]:
        return self.x.floor().long()

    @property
    def row(self) -> Int[Tensor, "gaussian"]:
        return self.y.floor().long()


def place(gaussians: Gaussians, cameras: Cameras) -> Placement:
    """The Gaussians of one scene (batch 1) in their views, in float64; of no view: in view 0."""
    view = gaussians.view_index.clamp(0, cameras.count - 1)
    x, y, depth = (
        torch.zeros(gaussians.count, dtype=torch.float64, device=view.device)
        for _ in range(3)
    )
    for index in range(cameras.count):
        mine = view == index
        x[mine], y[mine], depth[mine] = _project_to_view(
            gaussians.means[0, mine], cameras, index
        )
    focal = cameras.intrinsics[0, view, 0, 0] * cameras.image_size[1]
    return Placement(view, x, y, depth, depth.clamp(min=0) / focal)


def own_pixel_inside(
    gaussians: Gaussians, region: Region, cameras: Cameras
) -> Bool[Tensor, "gaussian"]:
    """Which lie on a pixel of the region in their own view; outside the nearest one counts."""
    placement = place(gaussians, cameras)
    height, width = cameras.image_size
    row = placement.row.clamp(0, height - 1)
    column = placement.column.clamp(0, width - 1)
    return region[placement.view, row, column] & (placement.depth > 0)


def _project_to_view(
    points: Float[Tensor, "point 3"], cameras: Cameras, view: int
) -> tuple[Float[Tensor, "point"], Float[Tensor, "point"], Float[Tensor, "point"]]:
    """Return x and y [pixels] and camera z of world points in one camera of the scene."""
    height, width = cameras.image_size
    image, z = project(
        points.double(),
        cameras.intrinsics[0, view].double(),
        cameras.c2w[0, view].double(),
    )
    x, y = (
        (image * image.new_tensor([width, height]))
        .clamp(-FAR_OUTSIDE, FAR_OUTSIDE)
        .unbind(-1)
    )
    return x, y, z


def duplicates(
    gaussians: Gaussians,
    cameras: Cameras,
    placement: Placement,
    alike_up_to: float,
) -> Bool[Tensor, "gaussian"]:
    """Find Gaussians (batch 1) on a surface that an earlier view shows in the same colour and no
    coarser.

    The pixel of the earlier view they fall on must hold an opaque Gaussian that is no duplicate
    itself, within `SAME_DEPTH`, and it or one around it must be within `alike_up_to` in colour (two
    views do not sample the same points).
    """
    doubled = torch.zeros_like(placement.view, dtype=torch.bool)
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    for earlier in range(cameras.count - 1):
        later = ((placement.view > earlier) & ~doubled).nonzero()[:, 0]
        nearest = _nearest_per_pixel(
            placement,
            (gaussians.opacities[0] > OPAQUE) & ~doubled,
            earlier,
            cameras.image_size,
        )
        x, y, depth = _project_to_view(gaussians.means[0, later], cameras, earlier)
        column, row = x.floor().long(), y.floor().long()
        other = _value_at(nearest, row, column)
        shown = (other >= 0) & (
            (depth - placement.depth[other]).abs() < SAME_DEPTH * depth
        )
        shown &= placement.pixel_size[other] < AS_FINE * placement.pixel_size[later]
        later, column, row = later[shown], column[shown], row[shown]
        alike = torch.zeros_like(later, dtype=torch.bool)
        for dy, dx in AROUND:
            near = _value_at(nearest, row + dy, column + dx)
            difference = (colours[later] - colours[near]).square().mean(-1)
            alike |= (near >= 0) & (difference <= alike_up_to**2)
        doubled[later[alike]] = True
    return doubled


def _nearest_per_pixel(
    placement: Placement,
    usable: Bool[Tensor, "gaussian"],
    view: int,
    size: tuple[int, int],
) -> Int[Tensor, "row column"]:
    """Index of the nearest usable Gaussian at each pixel of `view`; -1: there is none."""
    height, width = size
    row, column = placement.row, placement.column
    inside = (
        (column >= 0)
        & (column < width)
        & (row >= 0)
        & (row < height)
        & (placement.depth > 0)
    )
    index = ((placement.view == view) & inside & usable).nonzero()[:, 0]
    index = index[placement.depth[index].argsort(descending=True, stable=True)]
    nearest = torch.full((height * width,), -1, dtype=torch.long, device=index.device)
    # of several, the last written is the nearest
    nearest[row[index] * width + column[index]] = index
    return nearest.view(height, width)


def _value_at(
    table: Int[Tensor, "row column"],
    row: Int[Tensor, "point"],
    column: Int[Tensor, "point"],
) -> Int[Tensor, "point"]:
    """Look up the table at the points; -1 outside of it."""
    height, width = table.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return torch.where(
        inside, table[row.clamp(0, height - 1), column.clamp(0, width - 1)], -1
    )


def merge_groups(
    gaussians: Gaussians, group: Int[Tensor, "gaussian"], cameras: Cameras
) -> Gaussians:
    """Merge each group of Gaussians of one scene (batch 1) into one; those of group -1 stay
    unchanged.

    The result is in the order of the views; of a view, those of group -1 come first. A merged
    Gaussian has the mean, covariance and harmonics of its members weighted by opacity, and is
    widened in its plane until neighbours close the surface. It is moved a little away from its
    camera, because rasterizers draw by depth of the centres: wide ones then fill in behind finer
    ones on the same surface instead of covering them.
    """
    alone, members = (group < 0).nonzero()[:, 0], (group >= 0).nonzero()[:, 0]
    if members.numel() == 0:
        return gaussians
    merged = _merged(gaussians.select(members), group[members], cameras)
    result = Gaussians.cat((gaussians.select(alone), merged))
    return result.select(result.view_index.argsort(stable=True))


def _merged(
    gaussians: Gaussians, group: Int[Tensor, "gaussian"], cameras: Cameras
) -> Gaussians:
    """Return one Gaussian per group by matching moments."""
    groups = int(group.max()) + 1
    weight = gaussians.opacities[0].double().clamp(min=LEAST_WEIGHT)
    total = weight.new_zeros(groups).index_add_(0, group, weight)

    def mean(values: Float[Tensor, "gaussian *shape"]) -> Float[Tensor, "group *shape"]:
        share = (weight / total[group]).view(-1, *(1 for _ in values.shape[1:]))
        return values.new_zeros((groups, *values.shape[1:])).index_add_(
            0, group, share * values
        )

    points = gaussians.means[0].double()
    centre = mean(points)
    offset = points - centre[group]
    own = covariances(gaussians.scales[0].double(), gaussians.quats[0].double())
    variances, axes = torch.linalg.eigh(
        mean(offset[:, :, None] * offset[:, None] + own)
    )
    axes = axes * torch.linalg.det(axes).sign()[:, None, None]
    wider = variances.new_tensor([1.0, SPREAD, SPREAD])
    scales = variances.clamp(min=1e-24).sqrt() * wider
    view = gaussians.view_index.new_full((groups,), -1).scatter_reduce_(
        0, group, gaussians.view_index, "amax"
    )
    objects = gaussians.object_index
    if objects is not None:
        objects = view.new_full((groups,), -1).scatter_reduce_(
            0, group, objects, "amax"
        )
    unsure = gaussians.uncertainty
    if unsure is not None:
        unsure = mean(unsure[0].double())[None].to(gaussians.means.dtype)
    camera_centre = cameras.c2w[0, view.clamp(0, cameras.count - 1), :3, 3].double()
    direction = torch.nn.functional.normalize(centre - camera_centre, dim=-1)
    centre = centre + BEHIND * scales[:, 2:] * direction
    opacity = mean(gaussians.opacities[0].double())
    dtype = gaussians.means.dtype
    return Gaussians(
        centre[None].to(dtype),
        scales[None].to(dtype),
        matrices_to_quats(axes)[None].to(dtype),
        (1 - (1 - opacity).square())[None].to(dtype),
        mean(gaussians.harmonics[0].double())[None].to(dtype),
        view_index=view,
        object_index=objects,
        uncertainty=unsure,
    )
