"""One Gaussian in place of a group, by matching moments."""

import torch
from jaxtyping import Int
from torch import Tensor

from edit3r.geometry.rotations import covariances, matrices_to_quats
from edit3r.types import Cameras, Gaussians
from edit3r_refiners.simplify.settings import SimplifySettings

LEAST_WEIGHT = 1e-4  # transparent Gaussians still have a place


def merge_groups(
    gaussians: Gaussians, group: Int[Tensor, "gaussian"], cameras: Cameras, settings: SimplifySettings
) -> Gaussians:
    """The Gaussians of one scene (batch 1) with each group merged into one; those of group -1 unchanged.

    They are in the order of their views; of a view, those of group -1 come first.
    A merged Gaussian has the mean, covariance and harmonics of its members weighted by opacity, and is widened in its
    plane until neighbours close the surface. It is moved a little away from its camera, because rasterizers draw by
    depth of the centres: wide ones then fill in behind finer ones on the same surface instead of covering them.
    """
    alone, members = (group < 0).nonzero()[:, 0], (group >= 0).nonzero()[:, 0]
    if members.numel() == 0:
        return gaussians
    merged = _merged(gaussians.select(members), group[members], cameras, settings)
    result = Gaussians.cat((gaussians.select(alone), merged))
    return result.select(result.view_index.argsort(stable=True))


def _merged(gaussians: Gaussians, group: Tensor, cameras: Cameras, settings: SimplifySettings) -> Gaussians:
    groups = int(group.max()) + 1
    weight = gaussians.opacities[0].double().clamp(min=LEAST_WEIGHT)
    total = weight.new_zeros(groups).index_add_(0, group, weight)

    def mean(values: Tensor) -> Tensor:
        share = (weight / total[group]).view(-1, *(1 for _ in values.shape[1:]))
        return values.new_zeros((groups, *values.shape[1:])).index_add_(0, group, share * values)

    points = gaussians.means[0].double()
    centre = mean(points)
    offset = points - centre[group]
    own = covariances(gaussians.scales[0].double(), gaussians.quats[0].double())
    variances, axes = torch.linalg.eigh(mean(offset[:, :, None] * offset[:, None] + own))
    axes = axes * torch.linalg.det(axes).sign()[:, None, None]
    scales = variances.clamp(min=1e-24).sqrt() * variances.new_tensor([1.0, settings.spread, settings.spread])
    view = gaussians.view_index.new_full((groups,), -1).scatter_reduce_(0, group, gaussians.view_index, "amax")
    eye = cameras.c2w[0, view.clamp(0, cameras.count - 1), :3, 3].double()
    centre = centre + settings.behind * scales[:, 2:] * torch.nn.functional.normalize(centre - eye, dim=-1)
    opacity = mean(gaussians.opacities[0].double())
    values = centre, scales, matrices_to_quats(axes), 1 - (1 - opacity).square(), mean(gaussians.harmonics[0].double())
    return Gaussians(*(value[None].to(gaussians.means.dtype) for value in values), view_index=view)
