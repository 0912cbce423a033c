"""What photos say of each other: masks carried to photos without their own, and patches on which
photos of one surface disagree.
"""

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from edit3r.kit import asking
from edit3r.kit.geometry.warping import nearest_views, warp
from edit3r_select.answering import answered
from edit3r_select.marks import Marks
from edit3r_select.photos import Found, Mask, OnPhoto, Photos, clean

# of an object's pixels that must lie in another photo for geometry to say where it is there
MIN_SHARE = 0.2
MIN_AREA = 2e-4  # share of a photo under which a carried mask shows nothing
VOTES = 6  # photos near one that say what of it belongs to the thing
SURELY = 0.99  # share of four pixels whose depth was measured
THIN = 0.012  # radius of the disc that fits into what is a patch [longer sides]
EXACT = 100  # votes of a mask that is taken as it is: nothing outvotes it


def carried(photos: Photos, found: Found, missing: Iterable[int]) -> dict[int, OnPhoto]:
    """The masks of the `missing` photos: by what geometry says that the others show, those first
    to which it was carried, else followed from the nearest photo with a mask of its own.
    """
    known, wanted = dict(found), sorted(missing)
    own = [view for view, one in found.items() if one.is_own]
    nearest = {view: min(own, key=lambda one: abs(one - view)) for view in wanted}
    for view in wanted:
        if not found[nearest[view]].inside.any():  # an empty mask is carried as it is
            known[view] = OnPhoto(found[nearest[view]].mask, "pictures")
            continue
        marks = expected_on(photos, known, view)
        if marks is not None:
            mask = answered(photos.segmenter, photos.images[view], marks).mask
            known[view] = OnPhoto(clean(mask, photos.images), "geometry")
    lost = [view for view in wanted if view not in known]
    for source in {nearest[view] for view in lost}:
        for step in (1, -1):
            there = [view for view in lost if nearest[view] == source]
            there = [view for view in there if (view - source) * step > 0]
            known |= _followed(photos, known[source].mask, source, there)
    return {view: known[view] for view in wanted}


def expected_on(photos: Photos, found: Found, view: int) -> Marks | None:
    """Where photos with masks say that the object is; None where geometry cannot tell.

    Those with own masks are asked first, then those that geometry carried it to: of what they all
    do not see, nothing is known.
    """
    expected = torch.zeros_like(photos.images[view, 0])
    known = torch.zeros_like(expected, dtype=torch.bool)
    needed = float("inf")
    asked = [one for one in found if found[one].is_own]
    asked += [one for one in found if found[one].how == "geometry"]
    for source in asked:
        surface = photos.shared(view, source)
        if surface is None or not found[source].inside.any():
            continue
        grid, same = surface
        moved = warp(found[source].mask[None], grid, padding="zeros")[0]
        expected = torch.where(same & ~known, moved, expected)
        known |= same
        needed = min(needed, MIN_SHARE * float(found[source].inside.sum()))
    least = max(needed, MIN_AREA * expected.numel())
    if float((expected > 0.5).sum()) < least:
        return None
    return Marks(prior=expected, known=known)


def _followed(
    photos: Photos, mask: Mask, source: int, views: Sequence[int]
) -> dict[int, OnPhoto]:
    """The object of a photo on those to one side of it, followed through all between by a segmenter
    that can; else it is not found there.
    """
    if not views:
        return {}
    step = 1 if views[0] > source else -1
    way = list(range(source, (max(views) if step > 0 else min(views)) + step, step))
    tracks = asking.track(photos.segmenter, photos.images[way], mask[None])
    if tracks is None:
        return {view: OnPhoto(torch.zeros_like(mask), "not found") for view in views}
    found = {}
    for view in views:
        logits = tracks.logits[abs(view - source), 0]
        there = bool(tracks.present[abs(view - source), 0] and (logits > 0).any())
        found[view] = OnPhoto(
            clean(logits.sigmoid() * there, photos.images),
            "pictures" if there else "not found",
        )
    return found


def agreed(photos: Photos, found: Found, painted: set[int]) -> dict[int, OnPhoto]:
    """The masks with patches as most photos have them that measured one surface there: no nose
    without the colour of its bear. Masks that were given or `painted` are outvoted by none.

    Only patches count: outlines never lie at the same pixel.
    """
    geometry = photos.geometry
    exact = {view for view, one in found.items() if one.how in ("given", "region")}
    exact |= painted
    if geometry is None or exact >= found.keys():
        return dict(found)
    own = [view for view, one in found.items() if one.is_own]
    says = {
        view: one.mask
        for view, one in found.items()
        if one.how not in ("pictures", "not found")
    }
    near = nearest_views(geometry.c2w, geometry.depths, VOTES)
    voted = {}
    for view in says.keys() - exact:
        votes = torch.where(says[view] > 0.5, 1.0, -1.0)
        told = torch.zeros_like(votes, dtype=torch.bool)
        for other in dict.fromkeys((*own, *near[view])):
            if other != view and other in says:
                there, known = _said(photos, view, other, says[other])
                weight = EXACT if other in exact else 1
                votes += known * torch.where(there > 0.5, 1.0, -1.0) * weight
                told |= known
        wanted = votes >= 0
        differs = told & (wanted != found[view].inside)
        patches = differs & _wide(differs)
        mask = torch.where(patches, wanted.to(says[view]), says[view])
        voted[view] = OnPhoto(mask, found[view].how)
    return {**found, **voted}


def _said(
    photos: Photos, view: int, other: int, mask: Mask
) -> tuple[Mask, Bool[Tensor, "height width"]]:
    """The mask of another photo on the pixels of `view`, and where both measured one surface."""
    surface = photos.shared(view, other)
    assert photos.geometry is not None
    if surface is None:
        return mask, torch.zeros_like(mask, dtype=torch.bool)
    (grid, same), sure = surface, photos.geometry.is_measured[0]
    layers = torch.stack((mask, sure[other].to(mask)))
    moved, measured = warp(layers, grid, padding="zeros")
    return moved, same & sure[view] & (measured > SURELY)


def _wide(where: Bool[Tensor, "height width"]) -> Bool[Tensor, "height width"]:
    """The pixels about what is as wide as a disc of radius `THIN`."""
    radius = max(1, round(THIN * max(where.shape)))
    disc, twice = (
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
        for reach in (radius, 2 * radius)
    )
    core = cv2.erode(where.numpy(force=True).astype(np.uint8), disc)
    return torch.from_numpy(cv2.dilate(core, twice) > 0).to(where.device)
