"""The edit as a local function of colour, and how far it may be carried.

Per place an affine map turns the source image into its edited version: ridge regression of the
change r = edited - source on the source's colours s in a Gaussian window, D = Cov(r, s) (Cov(s, s)
+ ridge I)^-1, d = mean r - D mean s. An unedited place gives exactly D = 0, d = 0.
"""

from itertools import combinations_with_replacement

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.maps import dilate
from edit3r.geometry.warping import Correspondences, warp

CHANNELS = 12
"""Row-major 3x3 of D, then d."""

_CHANGE = 2 / 255
"""A change below this [sRGB] counts in proportion."""

_SAME_SURFACE = 0.05
"""Largest difference of log depth at which a pixel and its point in the reference are taken for one
surface.
"""

_ALIKE = 0.1
"""Mean difference of colours [sRGB] above which two images do not show one surface, whatever the
depths say.
"""

_EXPLAINED = 3 / 255
"""What one function of colour may leave of an edit [sRGB]: images of 8 bits round before and after.
"""

_FITTED = 4_000
"""Changed pixels that the function is fitted to, at least, where there are so many."""

_FITS = 6
"""Rounds of the robust fits."""

_LEAST_SPREAD = 1e-3
"""Variance of colours [sRGB^2] that keeps the gain of a plain image near 1."""

_PRODUCTS = tuple(combinations_with_replacement(range(4), 2))

_LUMA = (0.299, 0.587, 0.114)

_KNOTS = 8
"""Places from black to white between which the function changes linearly from one polynomial to the
next.
"""

_ROUNDED = 1.5 / 255
"""A channel this near to 0 or 1 was cut off there."""

_SPREAD = 0.02
"""How far around a change an edit may be carried [long sides]: outlines and matches are off by some
pixels.
"""


def fit_colour_maps(
    source: Float[Tensor, "batch 3 height width"],
    edited: Float[Tensor, "batch 3 height width"],
    stride: int = 1,
    sigma: float = 1.0,
    ridge: float = 2e-3,
) -> Float[Tensor, "batch 12 height2 width2"]:
    """Fit the map of every `stride` x `stride` cell to the cell and `sigma` cells around it."""
    change = edited - source
    moments = torch.cat(
        (source, change, _outer(change, source), _outer(source, source)), 1
    )
    moments = blur(F.avg_pool2d(moments, stride) if stride > 1 else moments, sigma)
    mean_s, mean_r, cross, own = moments.split((3, 3, 9, 9), 1)
    cross, own = cross - _outer(mean_r, mean_s), own - _outer(mean_s, mean_s)
    matrix = _matrices(own) + ridge * torch.eye(
        3, dtype=source.dtype, device=source.device
    )
    slope = _matrices(cross) @ torch.linalg.inv(
        matrix
    )  # D = Cov(r, s) (Cov(s, s) + ridge)^-1
    offset = mean_r - torch.einsum("bhwij,bjhw->bihw", slope, mean_s)
    return torch.cat((slope.flatten(-2).permute(0, 3, 1, 2), offset), 1)


def change_of(
    maps: Float[Tensor, "batch 12 height width"],
    source: Float[Tensor, "batch 3 height width"],
) -> Float[Tensor, "batch 3 height width"]:
    """Compute the colour change D s + d that the maps give to the source images."""
    slope = maps[:, :9].unflatten(1, (3, 3))
    return (slope * source[:, None]).sum(2) + maps[:, 9:]


def blur(
    x: Float[Tensor, "batch channel height width"], sigma: float
) -> Float[Tensor, "batch channel height width"]:
    """Blur with a Gaussian of standard deviation `sigma` [pixels]; the border is repeated."""
    radius = int(2.5 * sigma + 0.5)
    offsets = torch.arange(-radius, radius + 1, dtype=x.dtype, device=x.device)
    kernel = torch.exp(-0.5 * (offsets / sigma) ** 2)
    kernel = (kernel / kernel.sum()).expand(x.shape[1], 1, -1)
    padded = F.pad(x, (radius,) * 4, mode="replicate")
    rows = F.conv2d(padded, kernel[..., None, :], groups=x.shape[1])
    return F.conv2d(rows, kernel[..., None], groups=x.shape[1])


def _outer(
    a: Float[Tensor, "batch 3 h w"], b: Float[Tensor, "batch 3 h w"]
) -> Float[Tensor, "batch 9 h w"]:
    """Products of every channel of `a` with every channel of `b`, row-major."""
    return (a[:, :, None] * b[:, None]).flatten(1, 2)


def _matrices(flat: Float[Tensor, "batch 9 h w"]) -> Float[Tensor, "batch h w 3 3"]:
    return flat.permute(0, 2, 3, 1).unflatten(-1, (3, 3))


def looks_of(
    source: Float[Tensor, "batch view 3 height width"],
    matches: Correspondences,
    measured: Bool[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 6 1 1"]:
    """Return gain and offset of each channel from the reference's colours to each view's: exposure
    and white balance.

    They give the colours at matched places the same mean and spread, robustly. Exactly 1 and 0 for
    the reference, and where that takes less than a third off the difference.
    """
    there = warp(source[:, :1].expand_as(source), matches.coordinates)
    seen = (matches.inside * (measured & (matches.depth_ratio.abs() < _SAME_SURFACE)))[
        :, :, None
    ]
    weights = seen
    for _ in range(_FITS):
        share = weights / weights.sum((3, 4), keepdim=True).clamp(min=1e-6)
        means = [(share * x).sum((3, 4), keepdim=True) for x in (there, source)]
        spreads = [
            (share * (x - mean).square()).sum((3, 4), keepdim=True)
            for x, mean in zip((there, source), means)
        ]
        gain = ((spreads[1] + _LEAST_SPREAD) / (spreads[0] + _LEAST_SPREAD)).sqrt()
        left = (
            (gain * (there - means[0]) + means[1] - source).abs().amax(2, keepdim=True)
        )
        weights = seen / (1 + (left / _ALIKE).square())
    before = (there - source).abs().amax(2, keepdim=True)
    found = (seen * left).sum((3, 4), keepdim=True) < 2 / 3 * (seen * before).sum(
        (3, 4), keepdim=True
    )
    found[:, 0] = False
    none = torch.cat((torch.ones_like(gain), torch.zeros_like(gain)), 2)
    return torch.where(found, torch.cat((gain, means[1] - gain * means[0]), 2), none)


def shown_by_views(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    looks: Float[Tensor, "batch view 6 1 1"],
) -> Float[Tensor, "batch view 6 height width"]:
    """Return the reference unedited and edited, as it would be with the exposure and white balance
    of each view.
    """
    gain, offset = (look.repeat(1, 1, 2, 1, 1) for look in looks.split(3, 2))
    return (gain * torch.cat((source[:, :1], edited[:, :1]), 2) + offset).clamp(0, 1)


def near_an_edit(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    reference: Float[Tensor, "batch view 6 height width"],
    matches: Correspondences,
    measured: Bool[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view height width"]:
    """Return where an edit may be carried to: 1 near a change, exactly 0 where no image shows one.

    Everything else keeps the source's colours bit for bit. Changes of the reference count on the
    surfaces that it surely shows, changes of the view's own image everywhere. In a view that was
    not edited at all, what the reference does not show may take the edit too: 1.
    """
    reach = max(1, round(_SPREAD * max(source.shape[-2:])))
    speck = -(-reach // 5)
    change = (edited - source).abs().amax(2, keepdim=True)
    before, after = warp(reference, matches.coordinates).split(3, 2)
    of_reference = (after - before).abs().amax(2, keepdim=True)
    apart = _spread((before - source).abs().amax(2), reach / 5)
    seen = matches.inside * (
        measured & (matches.depth_ratio.abs() < _SAME_SURFACE) & (apart < _ALIKE)
    )
    change, of_reference = change[:, :, 0], of_reference[:, :, 0] * seen
    # Changes of a few pixels are left out: surfaces that look alike by chance.
    of_reference = dilate(-dilate(-of_reference, speck), speck)
    untouched = (change.amax((2, 3), keepdim=True) == 0) & (
        change[:, :1].amax((2, 3), keepdim=True) > 0
    )
    unknown = untouched & (seen == 0)
    found = torch.maximum(change, of_reference).clamp(max=_CHANGE) / _CHANGE
    found = _spread(dilate(found, reach), reach / 4)
    return torch.maximum(found, unknown.to(found.dtype))


@torch.no_grad()
def edits_conflict(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    reference: Float[Tensor, "batch view 6 height width"],
    matches: Correspondences,
    disagree: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view height width"]:
    """Return where a view's Gaussians should give way to the reference's: 1, falling to 0; the
    paper's figure 5.

    That is where the edits `disagree`, the view or the reference is edited, and the reference shows
    the same surface, so that no hole is left: at its depth or in front of it, or behind it in the
    same colours and edited too. A view that was not edited at all contradicts nothing: the edit is
    carried to it. 0 for the reference.
    """
    before, after = warp(reference, matches.coordinates).split(3, 2)
    elsewhere = (after - before).abs().amax(2) > _CHANGE
    own = (edited - source).abs().amax(2)
    contrary = torch.maximum((own / _CHANGE - 1).clamp(0, 1), elsewhere) * (
        own.amax((2, 3), keepdim=True) > _CHANGE
    )
    shown = (matches.depth_ratio < _SAME_SURFACE) | (
        elsewhere & ((source - before).abs().mean(2) < _ALIKE)
    )
    conflict = disagree * contrary * matches.inside * shown
    conflict[:, 0] = 0
    return conflict


@torch.no_grad()
def edits_disagree(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    reference: Float[Tensor, "batch view 6 height width"],
    matches: Correspondences,
) -> Float[Tensor, "batch view height width"]:
    """Return where a view's edit is not the reference's: 1, falling to exactly 0 where one function
    of colour is both.

    The function is fitted to the changed pixels of view and reference together. A view agrees where
    the function explains its colours, in full or in part as behind a soft mask, and where the
    reference, seen at the same place, is not left as it was while the view is edited or the other
    way round. A function that explains less than half of the changed pixels of either is not
    shared, and the view disagrees everywhere. The reference agrees with itself.
    """
    reach = max(1, round(_SPREAD * max(source.shape[-2:])))
    speck = -(-reach // 5)
    gaps = [torch.zeros_like(source[:, 0, 0])]
    for view in range(1, source.shape[1]):
        shown = _comparable(edited, source, reference, matches, view)
        before, after = (
            torch.stack((shown[:, :3], source[:, view]), 1),
            torch.stack((shown[:, 3:], edited[:, view]), 1),
        )
        change = after - before
        wished = _change_by_function(before, _shared_function(before, change))
        share = (wished * change).sum(2) / wished.square().sum(2).clamp(
            min=1e-9
        )  # of the wished change that was made
        left = (
            (change - share.clamp(0, 1)[:, :, None] * wished).abs().amax(2)
        )  # what the function does not explain
        changed = change.abs().amax(2) > _CHANGE
        shared = (changed & (left <= _EXPLAINED)).sum((2, 3)) >= 0.5 * changed.sum(
            (2, 3)
        ).clamp(min=1)
        telling = (
            wished.abs().amax(2) > 2 * _EXPLAINED
        )  # elsewhere, edited and unedited look alike
        made, kept = telling & (share > 0.5), telling & (share <= 0.5)
        there = (
            warp(
                torch.stack((made[:, 0], kept[:, 0]), 1).to(source.dtype),
                matches.coordinates[:, view],
            )
            > 0.5
        )
        opposed = (
            (there[:, 0] & kept[:, 1]) | (there[:, 1] & made[:, 1])
        ) * matches.inside[:, view]
        gap = torch.maximum((left[:, 1] / _EXPLAINED - 1).clamp(0, 1), opposed)
        # Thin lines are left out: outlines of two masks, and borders that mix two colours, are off
        # by a pixel or two.
        gap = dilate(-dilate(-gap, speck), speck)
        gaps.append(torch.where(shared.all(1)[:, None, None], dilate(gap, reach), 1.0))
    return torch.stack(gaps, 1)


def _comparable(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    reference: Float[Tensor, "batch view 6 height width"],
    matches: Correspondences,
    view: int,
) -> Float[Tensor, "batch 6 height width"]:
    """Return the reference to compare a view's edit with: as it is where both changed most matched
    places alike.

    So it is, too, where both changed most of the picture: a filter knows no exposure, grey is grey
    in any photo, and so many colours leave no room to tell two photos apart. Else the reference is
    taken as the view would show it.
    """
    before, after = reference[:, view].split(3, 1)
    there, own = (
        warp(after - before, matches.coordinates[:, view]),
        edited[:, view] - source[:, view],
    )
    size = torch.maximum(there.abs().amax(1), own.abs().amax(1))
    counted = (
        (size > _CHANGE)
        & (matches.inside[:, view] > 0)
        & (matches.depth_ratio[:, view].abs() < _SAME_SURFACE)
    )
    apart = counted & ((there - own).abs().amax(1) > 0.5 * size)
    alike = apart.sum((1, 2)) < 0.25 * counted.sum((1, 2))
    everywhere = [
        (change.abs().amax(1) > _CHANGE).float().mean((1, 2)) > 0.5
        for change in (own, after - before)
    ]
    alike |= everywhere[0] & everywhere[1]
    return torch.where(
        alike[:, None, None, None],
        torch.cat((source[:, 0], edited[:, 0]), 1),
        reference[:, view],
    )


def _shared_function(
    source: Float[Tensor, "batch view 3 height width"],
    change: Float[Tensor, "batch view 3 height width"],
) -> Float[Tensor, "batch 83 3"]:
    """Coefficients of the change as a function of the colour, over the changed pixels of all views
    of each scene.
    """
    return torch.stack(
        [
            _fitted(s, r)
            for s, r in zip(*(x.movedim(2, -1).flatten(1, 3) for x in (source, change)))
        ]
    )


def _fitted(
    colours: Float[Tensor, "pixel 3"], change: Float[Tensor, "pixel 3"]
) -> Float[Tensor, "83 3"]:
    """Robust least squares (Cauchy weights).

    A channel that an edit drove to 0 or 1 says that the function reaches it, no more.
    """
    changed = (change.abs().amax(-1) > _CHANGE).nonzero()[:, 0]
    some = changed[:: max(1, len(changed) // _FITTED)]
    s, r = colours[some].double(), change[some].double()
    features, after = _features(s), s + r
    low, high = after <= _ROUNDED, after >= 1 - _ROUNDED
    counts = ~(
        low | high
    )  # a channel that was cut off counts once the function falls short of it
    goal, weights = r, counts.to(r.dtype)
    ridge = 1e-6 * torch.eye(features.shape[-1], dtype=r.dtype, device=r.device)
    for _ in range(_FITS):
        weighted = features.mT * weights.mT[:, None]  # [channel, feature, pixel]
        moments, target = weighted @ features + ridge, weighted @ goal.mT[..., None]
        coefficients = torch.linalg.solve(moments, target)[..., 0].mT
        found = s + features @ coefficients
        beyond = (low & (found <= _ROUNDED)) | (high & (found >= 1 - _ROUNDED))
        left = torch.where(beyond, 0, after - found).abs().amax(-1, keepdim=True)
        counts, goal = counts | ~beyond, torch.where(beyond, found, after) - s
        weights = counts / (1 + (left / _EXPLAINED).square())
    return coefficients.to(colours.dtype)


def _change_by_function(
    source: Float[Tensor, "batch view 3 height width"],
    coefficients: Float[Tensor, "batch 83 3"],
) -> Float[Tensor, "batch view 3 height width"]:
    """The change that the function makes to each pixel, which stays within [0, 1]."""
    change = torch.einsum(
        "bvhwf,bfc->bvchw", _features(source.movedim(2, -1)), coefficients
    )
    return (source + change).clamp(0, 1) - source


def _features(colours: Float[Tensor, "*pixel 3"]) -> Float[Tensor, "*pixel 83"]:
    """All products of at most two channels, shared out between the two next knots of lightness, and
    each one's root.
    """
    padded = torch.cat((torch.ones_like(colours[..., :1]), colours), -1)
    products = torch.stack([padded[..., i] * padded[..., j] for i, j in _PRODUCTS], -1)
    knots = torch.arange(_KNOTS, dtype=colours.dtype, device=colours.device)
    near = (
        1
        - (
            (_KNOTS - 1) * (colours @ colours.new_tensor(_LUMA))[..., None] - knots
        ).abs()
    ).clamp(min=0)
    return torch.cat(
        (
            (near[..., None] * products[..., None, :]).flatten(-2),
            colours.clamp(min=0).sqrt(),
        ),
        -1,
    )


def _spread(
    maps: Float[Tensor, "batch view height width"], sigma: float
) -> Float[Tensor, "batch view height width"]:
    return blur(maps.flatten(0, 1)[:, None], sigma)[:, 0].unflatten(0, maps.shape[:2])
