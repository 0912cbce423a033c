"""Where edits disagree, where one may be carried to another view, and where a view gives way."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.warping import SAME_SURFACE, warp
from edit3r_model.colour_function import EXPLAINED, blur_maps, change_by_shared_function
from edit3r_model.edited_views import ALIKE, CHANGE, EditedViews, Maps

Pair = Float[Tensor, "batch 2 3 height width"]


def near_an_edit(
    views: EditedViews, measured: Bool[Tensor, "batch view height width"]
) -> Maps:
    """Return where an edit may be carried to: 1 near a change, exactly 0 where no image shows one.

    Everything else keeps the source's colours bit for bit. Changes of the reference count on the
    surfaces that it surely shows, changes of the view's own image everywhere. In a view that was
    not edited at all, what the reference does not show may take the edit too: 1.
    """
    before, after = views.reference
    reach, seen = views.reach, shown_by_reference(views, measured)
    change = views.change.abs().amax(2)
    # Changes of a few pixels are left out: surfaces that look alike by chance.
    of_reference = (after - before).abs().amax(2) * seen
    of_reference = _opened(of_reference, views.speck)
    largest = change.amax((2, 3), keepdim=True)
    untouched = (largest == 0) & (largest[:, :1] > 0)
    strength = torch.maximum(change, of_reference).clamp(max=CHANGE) / CHANGE
    strength = blur_maps(dilate(strength, reach), reach / 4)
    unknown = untouched & (seen == 0)
    return torch.maximum(strength, unknown.to(strength.dtype))


def shown_by_reference(
    views: EditedViews, measured: Bool[Tensor, "batch view height width"]
) -> Maps:
    """Return 1 where the reference surely shows the surface of a view's pixel, 0 elsewhere."""
    before, _ = views.reference
    matches = views.matches
    apart = blur_maps((before - views.source).abs().amax(2), views.reach / 5)
    same = measured & (matches.depth_ratio.abs() < SAME_SURFACE) & (apart < ALIKE)
    return matches.inside * same


@torch.no_grad()
def edits_conflict(views: EditedViews, disagree: Maps) -> Maps:
    """Return where a view's Gaussians should give way to the reference's: 1, falling to 0; the
    paper's figure 4.

    That is where the edits `disagree`, the view or the reference is edited, and the reference shows
    the same surface, so that no hole is left: at its depth or in front of it, or behind it in the
    same colours and edited too. A view that was not edited at all contradicts nothing: the edit is
    carried to it. 0 for the reference.
    """
    before, after = views.reference
    matches = views.matches
    elsewhere = (after - before).abs().amax(2) > CHANGE
    own = views.change.abs().amax(2)
    contrary = torch.maximum((own / CHANGE - 1).clamp(0, 1), elsewhere)
    contrary = contrary * (own.amax((2, 3), keepdim=True) > CHANGE)
    alike = (views.source - before).abs().mean(2) < ALIKE
    shown = (matches.depth_ratio < SAME_SURFACE) | (elsewhere & alike)
    return disagree * contrary * matches.inside * shown


@torch.no_grad()
def edits_disagree(views: EditedViews) -> Maps:
    """Return where a view's edit is not the reference's: 1, falling to exactly 0 where one function
    of colour is both.

    The function is fitted to the changed pixels of view and reference together. A view agrees where
    the function explains its colours, in full or in part as behind a soft mask, and where the
    reference, seen at the same place, is not left as it was while the view is edited or the other
    way round. A function that explains less than half of the changed pixels of either is not
    shared, and the view disagrees everywhere. The reference agrees with itself.
    """
    gaps = [torch.zeros_like(views.source[:, 0, 0])]
    for view in range(1, views.source.shape[1]):
        before, after = _comparable(views, view)
        gaps.append(_gap(views, view, before, after - before))
    return torch.stack(gaps, 1)


def _gap(
    views: EditedViews, view: int, before: Pair, change: Pair
) -> Float[Tensor, "batch height width"]:
    """Disagreement of one view; `before` and `change` are the reference's, then its own."""
    wished = _explained(before, change)
    # How much of the explained change was made, and what it does not explain.
    energy = wished.square().sum(2).clamp(min=1e-9)
    share = (wished * change).sum(2) / energy
    left = (change - share.clamp(0, 1)[:, :, None] * wished).abs().amax(2)
    changed = change.abs().amax(2) > CHANGE
    explained = (changed & (left <= EXPLAINED)).sum((2, 3))
    shared = explained >= 0.5 * changed.sum((2, 3)).clamp(min=1)
    # Elsewhere, edited and unedited look alike.
    telling = wished.abs().amax(2) > 2 * EXPLAINED
    made, kept = telling & (share > 0.5), telling & (share <= 0.5)
    there = torch.stack((made[:, 0], kept[:, 0]), 1).to(before.dtype)
    there = warp(there, views.matches.coordinates[:, view]) > 0.5
    opposed = (there[:, 0] & kept[:, 1]) | (there[:, 1] & made[:, 1])
    opposed = opposed * views.matches.inside[:, view]
    gap = torch.maximum((left[:, 1] / EXPLAINED - 1).clamp(0, 1), opposed)
    # Thin lines are left out: outlines of two masks, and borders that mix two colours, are off by
    # a pixel or two.
    gap = dilate(_opened(gap, views.speck), views.reach)
    return torch.where(shared.all(1)[:, None, None], gap, 1.0)


def _explained(before: Pair, change: Pair) -> Pair:
    """The change that one function of colour makes in both views, for each scene."""
    changed = [
        change_by_shared_function(s.movedim(1, -1), r.movedim(1, -1)).movedim(-1, 1)
        for s, r in zip(before, change)
    ]
    return torch.stack(changed)


def _comparable(views: EditedViews, view: int) -> tuple[Pair, Pair]:
    """Reference and view before and after the edit, to compare.

    The reference is taken as the view would show it; as it is, where both changed most matched
    places alike or most of the image: a filter knows no exposure, grey is grey in any photo, and so
    many colours leave no room to tell two photos apart.
    """
    matches = views.matches
    of_reference = views.after[:, view] - views.before[:, view]
    there = warp(of_reference, matches.coordinates[:, view])
    own = views.change[:, view]
    size = torch.maximum(there.abs().amax(1), own.abs().amax(1))
    same = matches.depth_ratio[:, view].abs() < SAME_SURFACE
    counted = (size > CHANGE) & (matches.inside[:, view] > 0) & same
    apart = counted & ((there - own).abs().amax(1) > 0.5 * size)
    alike = apart.sum((1, 2)) < 0.25 * counted.sum((1, 2))
    plain = alike | (_changes_most(own) & _changes_most(of_reference))
    plain = plain[:, None, None, None]
    before = torch.where(plain, views.source[:, 0], views.before[:, view])
    after = torch.where(plain, views.edited[:, 0], views.after[:, view])
    return (
        torch.stack((before, views.source[:, view]), 1),
        torch.stack((after, views.edited[:, view]), 1),
    )


def _changes_most(change: Float[Tensor, "batch 3 h w"]) -> Bool[Tensor, "batch"]:
    return (change.abs().amax(1) > CHANGE).float().mean((1, 2)) > 0.5


def _opened(maps: Tensor, radius: int) -> Tensor:
    """Morphological opening: nothing narrower than twice `radius` is left."""
    return dilate(-dilate(-maps, radius), radius)
