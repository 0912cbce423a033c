"""Merge pixel-aligned Gaussians over flat quadtree cells by matching moments."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.rotations import covariances, matrices_to_quats
from edit3r.simplify.cells import Placement, cell_keys
from edit3r.simplify.settings import SimplifySettings
from edit3r.types import Gaussians

MOST_STRETCH = 3.0  # longest axis of a cell against its side; more is a step in depth, not a slanted surface


@dataclass(frozen=True)
class _Sums:
    """Additive moments of groups of Gaussians; positions relative to the scene's median for precision."""

    count: Float[Tensor, "group"]
    weight: Float[Tensor, "group"]
    position: Float[Tensor, "group 3"]
    second: Float[Tensor, "group 3 3"]  # positions' outer products plus own covariances
    colour: Float[Tensor, "group 3"]
    colour_second: Float[Tensor, "group 3"]
    harmonics: Float[Tensor, "group coefficient 3"]
    opacity: Float[Tensor, "group"]
    footprint: Float[Tensor, "group"]

    def grouped(self, group: Int[Tensor, "member"], groups: int) -> "_Sums":
        """Add up members of the same group."""

        def add(values: Tensor) -> Tensor:
            return values.new_zeros((groups, *values.shape[1:])).index_add_(0, group, values)

        return _Sums(*(add(getattr(self, name)) for name in self.__dataclass_fields__))

    def select(self, index: Tensor) -> "_Sums":
        return _Sums(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def merge_flat(gaussians: Gaussians, placement: Placement, settings: SimplifySettings) -> Gaussians:
    """Merge bottom-up: four accepted cells become one when the union is still of one colour and one plane.

    A cell larger than a pixel is only taken when its neighbours are at most one level finer, so that no wide Gaussian
    reaches into detail. Batch 1; the order becomes: by level, then view, row and column.
    """
    origin = gaussians.means[0].double().median(0).values
    sums = _single(gaussians, placement, origin)
    view = gaussians.view_index
    level_of = _levels(sums, placement, settings)
    parts = []
    for level in range(settings.largest_cell + 1):
        members = (level_of == level).nonzero()[:, 0]
        if level > 0 and members.numel() == 0:
            break
        if level == 0:
            parts.append(gaussians.select(members))
            continue
        _, group = cell_keys(placement, level)[members].unique(return_inverse=True)
        groups = int(group.max()) + 1
        merged = sums.select(members).grouped(group, groups)
        owner = view.new_zeros(groups).index_copy_(0, group, view[members])
        parts.append(_to_gaussians(merged, origin, owner, settings.spread, gaussians))
    return Gaussians.cat(parts)


def _single(gaussians: Gaussians, placement: Placement, origin: Tensor) -> _Sums:
    position = gaussians.means[0].double() - origin
    weight = gaussians.opacities[0].double().clamp(min=1e-4)
    colour = dc_to_colour(gaussians.harmonics[0, :, 0]).double()
    second = position[:, :, None] * position[:, None] + covariances(gaussians.scales[0], gaussians.quats[0]).double()
    return _Sums(
        count=torch.ones_like(weight),
        weight=weight,
        position=weight[:, None] * position,
        second=weight[:, None, None] * second,
        colour=weight[:, None] * colour,
        colour_second=weight[:, None] * colour.square(),
        harmonics=weight[:, None, None] * gaussians.harmonics[0].double(),
        opacity=weight * gaussians.opacities[0].double(),
        footprint=weight * placement.footprint.double(),
    )


def _levels(sums: _Sums, placement: Placement, settings: SimplifySettings) -> Int[Tensor, "gaussian"]:
    """The level of the cell each Gaussian is merged into; 0: stays itself."""
    level_of = torch.zeros_like(placement.view)
    accepted = torch.ones_like(level_of, dtype=torch.bool)
    for level in range(1, settings.largest_cell + 1):
        _, group = cell_keys(placement, level).unique(return_inverse=True)
        groups = int(group.max()) + 1 if group.numel() else 0
        whole = torch.ones(groups, dtype=torch.bool, device=group.device)
        whole[group[~accepted]] = False  # a child was refused
        union = sums.grouped(group, groups)
        good = whole & (union.count > 1) & _flat(union, level, settings)
        accepted = good[group] & _calm(placement, good[group], level)
        # A cell is taken or refused as a whole, also after the look at its neighbours.
        refused = torch.zeros(groups, dtype=torch.bool, device=group.device)
        refused[group[~accepted]] = True
        accepted = ~refused[group]
        level_of[accepted] = level
        if not bool(accepted.any()):
            break
    return level_of


def _flat(sums: _Sums, level: int, settings: SimplifySettings) -> Bool[Tensor, "group"]:
    """One colour, one plane, no step in depth."""
    weight = sums.weight[:, None]
    spread = (sums.colour_second / weight - (sums.colour / weight).square()).clamp(min=0).mean(-1).sqrt()
    _, covariance = _moments(sums)
    variances = torch.linalg.eigvalsh(covariance).clamp(min=0)
    footprint = sums.footprint / sums.weight
    plane = variances[:, 0].sqrt() <= settings.flatness * footprint * 2 ** (0.5 * level)
    compact = variances[:, 2].sqrt() <= MOST_STRETCH * footprint * 2**level
    return (spread <= settings.colour) & plane & compact


def _calm(placement: Placement, good: Bool[Tensor, "gaussian"], level: int) -> Bool[Tensor, "gaussian"]:
    """Whether the eight neighbouring cells half this size hold no Gaussian that stays behind."""
    half = level - 1
    keys = cell_keys(placement, half)
    busy = keys[~good].unique()
    calm = good.clone()
    reach = 1 << half
    for dy in (-reach, 0, reach):
        for dx in (-reach, 0, reach):
            if dx == dy == 0:
                continue
            moved = Placement(placement.view, placement.x + dx, placement.y + dy, placement.depth, placement.footprint)
            calm &= ~torch.isin(cell_keys(moved, half), busy)
    return calm


def _moments(sums: _Sums) -> tuple[Float[Tensor, "group 3"], Float[Tensor, "group 3 3"]]:
    weight = sums.weight[:, None]
    mean = sums.position / weight
    return mean, sums.second / weight[..., None] - mean[:, :, None] * mean[:, None]


def _to_gaussians(sums: _Sums, origin: Tensor, view: Tensor, spread: float, like: Gaussians) -> Gaussians:
    """Moment-matched Gaussians, widened by `spread` in their plane so that neighbours close the surface."""
    mean, covariance = _moments(sums)
    variances, axes = torch.linalg.eigh(covariance)
    axes = axes * torch.linalg.det(axes).sign()[:, None, None]
    factor = variances.new_tensor([1.0, spread, spread])
    scales = variances.clamp(min=0).sqrt() * factor
    weight = sums.weight[:, None]
    opacity = sums.opacity / sums.weight
    dtype = like.means.dtype
    return Gaussians(
        means=(mean + origin)[None].to(dtype),
        scales=scales[None].to(dtype),
        quats=matrices_to_quats(axes)[None].to(dtype),
        opacities=(1 - (1 - opacity).square())[None].to(dtype),
        harmonics=(sums.harmonics / weight[..., None])[None].to(dtype),
        view_index=view,
    )
