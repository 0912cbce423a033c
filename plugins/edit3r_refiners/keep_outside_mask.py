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

from edit3r.config import Settings as BaseSettings
from edit3r.interfaces import Rasterizer, Refiner
from edit3r.reporting import note, warn
from edit3r.types import Cameras, EditRequest, Gaussians, Views
from edit3r_refiners.footprint import Outlines, cells_of, measured_footprint
from edit3r_refiners.simplify.contribution import contributions
from edit3r_refiners.simplify.placement import place

Region = Bool[Tensor, "view height width"]
SHAPE = ("means", "scales", "quats", "opacities")
VALUES = (*SHAPE, "harmonics")


class KeepOutsideMask(Refiner):
    """Keeps what shows outside the masks as it was before the edit, bit for bit."""

    needs_before = True

    class Settings(BaseSettings):
        pass

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, views: Views, request: EditRequest, rasterizer: Rasterizer
    ) -> Gaussians:
        """`request.before` with those Gaussians replaced that show only where `request.masks` are above 0.

        Without masks, or where they cover every pixel, `gaussians` come back unchanged.
        """
        if request.masks is None or bool((request.masks > 0).all()):
            return gaussians
        if request.before is None:
            warn("keep-outside-mask: the scene before the edit is not known; nothing is kept as it was.")
            return gaussians
        if request.masks.shape[0] != 1:
            warn("several scenes at once: the Gaussians outside the masks are reconstructed anew, not kept.")
            return gaussians
        region = request.masks[0] > 0
        note("keep_outside_mask.region_share", round(float(region.float().mean()), 4))
        with torch.no_grad():
            return graft(request.before, gaussians, region, cameras, rasterizer).gaussians


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
    note("keep_outside_mask.wanted_gaussians", int(wanted.sum()))
    note("keep_outside_mask.replaced_gaussians", int(replaced.sum()))
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
    note("keep_outside_mask.replaced_gaussians", int((~kept).sum()))
    note("keep_outside_mask.inserted_gaussians", int(inserted.sum()))
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
    lengths = [gaussians.means[0, still].norm(dim=-1) for gaussians in (before, after)]
    factor = float((lengths[0] / lengths[1].clamp(min=1e-12)).median())
    if abs(factor - 1) < 1e-6:
        return after
    note("keep_outside_mask.rescaled_by", factor)
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
