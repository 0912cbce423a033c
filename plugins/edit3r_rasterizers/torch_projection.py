"""Project 3D Gaussians onto a picture with plain tensor operations (EWA splatting, Zwicker et al. 2001).

Computed in float64 where the device has it: positions in a wide picture and needles need more than 24 bits.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.harmonics import basis
from edit3r.geometry.rotations import quats_to_matrices
from edit3r.types import Gaussians
from edit3r_rasterizers.settings import BORDER, MAX_COLOUR, RasterizerSettings


@dataclass(frozen=True)
class Splats:
    """The Gaussians one camera sees, front to back.

    With d = pixel - mean the exponent is sigma = (narrowness * (d_x - slope * d_y))^2 / 2 + (flatness * d_y)^2 / 2, the
    2D covariance [[a, b], [b, c]] written as d_y with variance c and d_x given d_y with variance a - b^2 / c. No
    large terms cancel, which they do in the usual quadratic form of a needle.
    """

    means: Float[Tensor, "splat 2"]  # [pixels]
    slope: Float[Tensor, "splat"]  # b / c
    narrowness: Float[Tensor, "splat"]  # 1 / sqrt(a - b^2 / c) [1 / pixels]
    flatness: Float[Tensor, "splat"]  # 1 / sqrt(c) [1 / pixels]
    opacities: Float[Tensor, "splat"]
    features: Float[Tensor, "splat 4"]  # colour >= 0, then camera z [scene units]
    extents: Float[Tensor, "splat 2"]  # half size of the box outside of which alpha < min_alpha [pixels]; no gradient


def project_scene(
    gaussians: Gaussians,
    scene: int,
    c2w: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    image_size: tuple[int, int],
    settings: RasterizerSettings,
) -> Splats:
    """Splats of one scene for one camera with normalised intrinsics; differentiable in all fields of `gaussians`."""
    work = working_dtype(gaussians.means)
    offsets = gaussians.means[scene].to(work) - c2w[:3, 3].to(work)  # subtracting first is exact far from the origin
    rotation = c2w[:3, :3].to(work)
    depth = (offsets.detach() @ rotation)[:, 2]
    opacities = gaussians.opacities[scene].to(work)
    kept = (depth >= settings.near) & (depth <= settings.far) & (opacities.detach() >= settings.min_alpha)
    index = kept.nonzero().squeeze(-1)
    index = index[depth[index].argsort(stable=True)]  # front to back, ties in index order

    camera = offsets[index] @ rotation
    height, width = image_size
    size = intrinsics.new_tensor([width, height], dtype=work)
    focal = intrinsics.to(work)[[0, 1], [0, 1]] * size  # [pixels]
    centre = intrinsics.to(work)[:2, 2] * size
    tangents = camera[:, :2] / camera[:, 2:]
    rows = _image_rows(tangents, camera[:, 2], focal, centre, size, rotation)
    shape = quats_to_matrices(gaussians.quats[scene, index].to(work)) * gaussians.scales[scene, index, None].to(work)
    across, down = (rows @ shape).unbind(-2)  # covariance a = |across|^2 + eps2d, b = across . down, ...
    variance_x = across.square().sum(-1) + settings.eps2d
    variance_y = down.square().sum(-1) + settings.eps2d
    down = down / variance_y.sqrt()[:, None]
    spread = torch.linalg.cross(across, down).square().sum(-1)
    variance_given_y = spread + settings.eps2d * (1 + across.square().sum(-1) / variance_y)
    reach = 2 * (opacities[index] / settings.min_alpha).log()
    variances = torch.stack((variance_x, variance_y), -1)
    colours = seen_colours(gaussians.harmonics[scene, index].to(work), offsets[index])
    return Splats(
        means=tangents * focal + centre,
        slope=(across * down).sum(-1) / variance_y.sqrt(),
        narrowness=variance_given_y.rsqrt(),
        flatness=variance_y.rsqrt(),
        opacities=opacities[index],
        features=torch.cat((colours, camera[:, 2:]), -1),
        extents=(reach[:, None] * variances).detach().sqrt(),
    )


def _image_rows(
    tangents: Float[Tensor, "splat 2"],
    depth: Float[Tensor, "splat"],
    focal: Float[Tensor, "2"],
    centre: Float[Tensor, "2"],
    size: Float[Tensor, "2"],
    rotation: Float[Tensor, "3 3"],
) -> Float[Tensor, "splat 2 3"]:
    """Jacobian of the picture position by the world position, at the tangents clamped near the picture's border."""
    margin = BORDER * 0.5 * size / focal
    low, high = -(centre / focal + margin), (size - centre) / focal + margin
    x, y = tangents.clamp(low, high).unbind(-1)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    rows = torch.stack((torch.stack((one, zero, -x), -1), torch.stack((zero, one, -y), -1)), -2)
    return (focal[:, None] * rows / depth[:, None, None]) @ rotation.T


def seen_colours(
    harmonics: Float[Tensor, "splat coefficient 3"], offsets: Float[Tensor, "splat 3"]
) -> Float[Tensor, "splat 3"]:
    """Colours seen along `offsets` from the camera centre to the Gaussians."""
    degree = round(harmonics.shape[1] ** 0.5) - 1
    values = basis(offsets / offsets.norm(dim=-1, keepdim=True), degree)
    return (torch.einsum("nk,nkc->nc", values, harmonics) + 0.5).clamp(0, MAX_COLOUR)


def working_dtype(like: Tensor) -> torch.dtype:
    """float64, or the tensor's own dtype on a device without (Apple's mps)."""
    return like.dtype if like.device.type == "mps" else torch.float64
