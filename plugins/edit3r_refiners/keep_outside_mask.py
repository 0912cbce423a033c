"""An edit put into a scene: what shows outside the edited region stays as it was, bit for bit.

    scene before --.                     shows outside the region in some view --> stays
    scene after  --+--> which Gaussians? shows inside only                     --> the edited scene's in its place

Which pixels a Gaussian shows in is read from the rasterizer (blending weight, the gradient of the picture by its
colour), so the rule holds for any reconstructor's Gaussians.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.alignment import median_scale
from edit3r.interfaces import Rasterizer
from edit3r.reporting import note
from edit3r.types import Cameras, Gaussians
from edit3r_refiners.footprint import Outlines, cells_of, measured_footprint
from edit3r_refiners.simplify.contribution import contributions
from edit3r_refiners.simplify.placement import place

Region = Bool[Tensor, "view height width"]
SHAPE = ("means", "scales", "quats", "opacities")
VALUES = (*SHAPE, "harmonics")


@dataclass(frozen=True)
class Graft:
    """A scene with an edit in it."""

    gaussians: Gaussians
    removed: Gaussians  # of the scene before that are gone
    inserted: Gaussians  # that are new


def graft(before: Gaussians, after: Gaussians, region: Region, cameras: Cameras, rasterizer: Rasterizer) -> Graft:
    """Replace those of `before` (batch 1) that show only inside `region` of the cameras' pictures.

    Where both reconstructions have the same structure (as many Gaussians, from the same views: one per pixel), each is
    replaced by its counterpart, and only if neither shows outside. Otherwise those of `before` that show inside alone
    go, and those of `after` that do so come; a gap may then stay along the border.
    """
    if same_structure(before, after):
        return _graft_counterparts(before, _in_unit_of(before, after, region, cameras), region, cameras, rasterizer)
    return _graft_sets(before, after, region, cameras, rasterizer)


def same_structure(before: Gaussians, after: Gaussians) -> bool:
    """Whether Gaussian i of one is Gaussian i of the other."""
    same = before.count == after.count and before.harmonics.shape == after.harmonics.shape
    return same and torch.equal(before.view_index, after.view_index) and bool((before.view_index >= 0).all())


def differing(before: Gaussians, after: Gaussians, names: tuple[str, ...] = VALUES) -> Bool[Tensor, "gaussian"]:
    """Which Gaussians of one structure differ in any bit."""
    differs = torch.zeros(before.count, dtype=torch.bool, device=before.means.device)
    for name in names:
        differs |= (getattr(before, name)[0] != getattr(after, name)[0]).reshape(before.count, -1).any(1)
    return differs


def _graft_counterparts(
    before: Gaussians, after: Gaussians, region: Region, cameras: Cameras, rasterizer: Rasterizer
) -> Graft:
    own = _own_pixel_inside(before, region, cameras)
    wanted = differing(before, after) & own
    replaced = wanted & ~_shows_outside(before, wanted, region, cameras, rasterizer)
    # Equal shapes have equal weights. Otherwise the new one may reach further, and what it hid may come forth.
    reshaped = bool((replaced & differing(before, after, SHAPE)).any())
    while reshaped and replaced.any():
        spilling = replaced & _shows_outside(_mixed(before, after, replaced), replaced, region, cameras, rasterizer)
        replaced &= ~spilling
        reshaped = bool(spilling.any())
    note("reuse.wanted_gaussians", int(wanted.sum()))
    note("reuse.replaced_gaussians", int(replaced.sum()))
    return Graft(_mixed(before, after, replaced), before.select(replaced), after.select(replaced))


def _graft_sets(before: Gaussians, after: Gaussians, region: Region, cameras: Cameras, rasterizer: Rasterizer) -> Graft:
    inside, outside = (_weights(before, pixels, cameras, rasterizer) for pixels in (region, ~region))
    kept = ~((inside > 0) & (outside == 0))
    inside, outside = (_weights(after, pixels, cameras, rasterizer) for pixels in (region, ~region))
    inserted = (inside > 0) & (outside == 0)
    old = before.select(kept)
    while inserted.any():
        both = _joined(old, after.select(inserted))
        new = torch.arange(both.count, device=inserted.device) >= old.count
        spilling = _shows_outside(both, new, region, cameras, rasterizer)[old.count :]
        if not spilling.any():
            break
        inserted[inserted.nonzero()[:, 0][spilling]] = False
    note("reuse.replaced_gaussians", int((~kept).sum()))
    note("reuse.inserted_gaussians", int(inserted.sum()))
    return Graft(_joined(old, after.select(inserted)), before.select(~kept), after.select(inserted))


def _shows_outside(
    gaussians: Gaussians, asked: Bool[Tensor, "gaussian"], region: Region, cameras: Cameras, rasterizer: Rasterizer
) -> Bool[Tensor, "gaussian"]:
    """Which of the Gaussians `asked` about add anything to a pixel outside the region; False for the others.

    The rasterizer is only asked about those near the outside, and shown all that is there.
    """
    found = torch.zeros_like(asked)
    if not asked.any() or region.all():
        return found
    footprint = measured_footprint(rasterizer, gaussians.means)
    if footprint is None:
        return asked & (_weights(gaussians, ~region, cameras, rasterizer) > 0)
    everything = Outlines(gaussians, footprint)
    for index in range(cameras.count):
        outside = cells_of(~region[index])
        border = everything.meeting(cameras, index, outside)
        cells = Outlines(gaussians.select(border[asked[border]]), footprint).cells(cameras, index)
        near = everything.meeting(cameras, index, cells & outside)
        weights = _weights(gaussians.select(near), ~region[index, None], cameras.select([index]), rasterizer)
        found[near[weights > 0]] = True
    return asked & found


def _weights(gaussians: Gaussians, pixels: Region, cameras: Cameras, rasterizer: Rasterizer) -> Float[Tensor, "n"]:
    return contributions(gaussians, cameras, rasterizer, pixels)[0]


def _own_pixel_inside(gaussians: Gaussians, region: Region, cameras: Cameras) -> Bool[Tensor, "gaussian"]:
    """Whether each lies on a pixel of the region in the view it came from; outside the picture the nearest counts."""
    placement = place(gaussians, cameras)
    height, width = cameras.image_size
    row, column = placement.row.clamp(0, height - 1), placement.column.clamp(0, width - 1)
    return region[placement.view, row, column] & (placement.depth > 0)


def _in_unit_of(before: Gaussians, after: Gaussians, region: Region, cameras: Cameras) -> Gaussians:
    """`after` in the unit of length of `before`: networks without poses choose one per answer.

    The view-0 camera is the frame of both, so a factor is all there is; the Gaussians outside the region tell it.
    """
    if not differing(before, after, ("means",)).any():
        return after
    still = ~_own_pixel_inside(before, region, cameras)
    if not still.any():
        return after
    factor = float(median_scale(after.means[0, still], before.means[0, still]))
    if abs(factor - 1) < 1e-6:
        return after
    note("reuse.rescaled_by", factor)
    return replace(after, means=after.means * factor, scales=after.scales * factor)


def _mixed(before: Gaussians, after: Gaussians, replaced: Bool[Tensor, "gaussian"]) -> Gaussians:
    def chosen(name: str) -> Tensor:
        old, new = getattr(before, name), getattr(after, name)
        return torch.where(replaced.view(1, -1, *(1,) * (old.dim() - 2)), new, old)

    return replace(before, **{name: chosen(name) for name in VALUES})


def _joined(first: Gaussians, second: Gaussians) -> Gaussians:
    """Both, with as many harmonics as the richer of them."""
    most = max(first.harmonics.shape[2], second.harmonics.shape[2])

    def padded(gaussians: Gaussians) -> Gaussians:
        missing = most - gaussians.harmonics.shape[2]
        return replace(gaussians, harmonics=torch.nn.functional.pad(gaussians.harmonics, (0, 0, 0, missing)))

    return Gaussians.cat((padded(first), padded(second)))
