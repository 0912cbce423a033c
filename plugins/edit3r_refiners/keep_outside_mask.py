"""Put an edit into a scene such that what shows outside the masks stays as it was, bit for bit.

    Gaussians before --.                    shows outside the region in some view --> stays
    Gaussians after  --+--> each Gaussian:  shows inside only, or nowhere --> the edited one

What shows nowhere continues the photos beyond their borders and behind things: left as it was, it
would surround the edit with the old colours. Which pixels a Gaussian shows in is read from the
rasterizer (its blending weights), so the rule holds for any reconstructor's Gaussians.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import (
    ComparesWithBefore,
    Rasterizer,
    RefineInputs,
    Refiner,
)
from edit3r.contract.reporting import note, warn
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.maps import size_of
from edit3r_refiners.merging import Region, own_pixel_inside

SHAPE = ("means", "scales", "quats", "opacities")
FIELDS = (*SHAPE, "harmonics")


class KeepOutsideMask(Refiner, ComparesWithBefore):
    """Keeps what shows outside the masks as it was before the edit, bit for bit."""

    def __call__(self, gaussians: Gaussians, inputs: RefineInputs) -> Gaussians:
        """Return the scene before the edit with those Gaussians replaced that do not show outside
        the masks.

        Without masks, or where they cover every pixel, `gaussians` come back unchanged.
        """
        if inputs.masks is None or not inputs.confined:
            return gaussians
        if inputs.before is None:
            warn(
                "keep-outside-mask: the scene before the edit is not known; nothing is kept."
            )
            return gaussians
        if inputs.masks.shape[0] != 1:
            warn(
                "several scenes at once: the Gaussians outside the masks are reconstructed anew, "
                "not kept."
            )
            return gaussians
        region = inputs.masks[0] > 0
        note("keep_outside_mask.region_share", round(float(region.float().mean()), 4))
        cameras = inputs.cameras.at(size_of(region))
        with torch.no_grad():
            return insert_edit(
                inputs.before, gaussians, region, cameras, inputs.rasterizer
            )


def insert_edit(
    before: Gaussians,
    after: Gaussians,
    region: Region,
    cameras: Cameras,
    rasterizer: Rasterizer,
) -> Gaussians:
    """Replace those Gaussians of `before` (batch 1) that show in no pixel outside `region` by those
    of `after`.

    Where both reconstructions have the same structure (as many Gaussians, from the same views: one
    per pixel), each Gaussian is replaced by its counterpart, and only if neither shows outside.
    Otherwise those of `before` that do not show outside go, and those of `after` that do not come;
    a gap may then stay along the border. An empty region changes nothing.
    """
    if not region.any():
        return before
    if same_structure(before, after):
        after = _in_unit_of(before, after, region, cameras)
        return _replace_counterparts(before, after, region, cameras, rasterizer)
    return _replace_sets(before, after, region, cameras, rasterizer)


def same_structure(before: Gaussians, after: Gaussians) -> bool:
    """Tell whether Gaussian i of one scene is the counterpart of Gaussian i of the other."""
    same = (
        before.count == after.count and before.harmonics.shape == after.harmonics.shape
    )
    return (
        same
        and torch.equal(before.view_index, after.view_index)
        and bool((before.view_index >= 0).all())
    )


def differing(
    before: Gaussians, after: Gaussians, names: tuple[str, ...] = FIELDS
) -> Bool[Tensor, "gaussian"]:
    """Which Gaussians of two scenes (batch 1, one structure) differ in a bit of the fields."""
    differs = torch.zeros(before.count, dtype=torch.bool, device=before.means.device)
    for name in names:
        differs |= (
            (getattr(before, name)[0] != getattr(after, name)[0])
            .reshape(before.count, -1)
            .any(1)
        )
    return differs


def _replace_counterparts(
    before: Gaussians,
    after: Gaussians,
    region: Region,
    cameras: Cameras,
    rasterizer: Rasterizer,
) -> Gaussians:
    """Replace Gaussians one by one, for scenes of the same structure."""
    differ = differing(before, after)
    replaced = differ & ~_show_in(before, ~region, cameras, rasterizer)
    # Equal shapes have equal weights. Otherwise the new one may show further out, and what it hid
    # may appear.
    reshaped = bool((replaced & differing(before, after, SHAPE)).any())
    while reshaped and replaced.any():
        spilling = replaced & _show_in(
            _mixed(before, after, replaced), ~region, cameras, rasterizer
        )
        replaced &= ~spilling
        reshaped = bool(spilling.any())
    note("keep_outside_mask.wanted_gaussians", int(differ.sum()))
    note("keep_outside_mask.replaced_gaussians", int(replaced.sum()))
    return _mixed(before, after, replaced)


def _replace_sets(
    before: Gaussians,
    after: Gaussians,
    region: Region,
    cameras: Cameras,
    rasterizer: Rasterizer,
) -> Gaussians:
    """Replace all Gaussians that do not show outside, for scenes of different structure."""
    removed, inserted = (
        ~_show_in(gaussians, ~region, cameras, rasterizer)
        for gaussians in (before, after)
    )
    kept = before.select(~removed)
    while inserted.any():
        both = _concatenated(kept, after.select(inserted))
        spilling = _show_in(both, ~region, cameras, rasterizer)[kept.count :]
        if not spilling.any():
            break
        inserted[inserted.nonzero()[:, 0][spilling]] = False
    note("keep_outside_mask.replaced_gaussians", int(removed.sum()))
    note("keep_outside_mask.inserted_gaussians", int(inserted.sum()))
    return _concatenated(kept, after.select(inserted))


def _show_in(
    gaussians: Gaussians, pixels: Region, cameras: Cameras, rasterizer: Rasterizer
) -> Bool[Tensor, "gaussian"]:
    """Tell which Gaussians add anything to the pixels."""
    return rasterizer.contributions(gaussians, cameras, pixels)[0] > 0


def _in_unit_of(
    before: Gaussians, after: Gaussians, region: Region, cameras: Cameras
) -> Gaussians:
    """Bring `after` to the unit of length of `before`: networks without poses choose one per
    answer.

    The view-0 camera is the frame of both, so a factor is all there is; the Gaussians outside the
    region tell it.
    """
    if not differing(before, after, ("means",)).any():
        return after
    still = ~own_pixel_inside(before, region, cameras)
    if not still.any():
        return after
    factor = float(median_scale(after.means[0, still], before.means[0, still]))
    if abs(factor - 1) < 1e-6:
        return after
    note("keep_outside_mask.rescaled_by", factor)
    return replace(after, means=after.means * factor, scales=after.scales * factor)


def _mixed(
    before: Gaussians, after: Gaussians, replaced: Bool[Tensor, "gaussian"]
) -> Gaussians:
    """Gaussians of `after` where `replaced`, else of `before`; both have one structure."""

    def chosen(name: str) -> Float[Tensor, "1 gaussian *field"]:
        old, new = getattr(before, name), getattr(after, name)
        return torch.where(replaced.view(1, -1, *(1,) * (old.dim() - 2)), new, old)

    return replace(before, **{name: chosen(name) for name in FIELDS})


def _concatenated(first: Gaussians, second: Gaussians) -> Gaussians:
    """Join both scenes, with as many harmonics as the richer of them."""
    most = max(first.harmonics.shape[2], second.harmonics.shape[2])

    def padded(gaussians: Gaussians) -> Gaussians:
        missing = most - gaussians.harmonics.shape[2]
        return replace(
            gaussians,
            harmonics=torch.nn.functional.pad(gaussians.harmonics, (0, 0, 0, missing)),
        )

    return Gaussians.cat((padded(first), padded(second)))


def median_scale(
    source: Float[Tensor, "point 3"], target: Float[Tensor, "point 3"]
) -> Float[Tensor, ""]:
    """The factor that brings `source` to the size of `target`: the median ratio of their distances
    from the origin.

    Point i of both is the same point, in two frames with one origin but other units. 1 for none.
    """
    if len(source) == 0:
        return target.new_ones(())
    return (target.norm(dim=-1) / source.norm(dim=-1).clamp(min=1e-12)).median()
