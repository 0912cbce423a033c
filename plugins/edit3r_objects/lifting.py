"""Masks of views become Gaussians: which of a scene's Gaussians are one object."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians

# The numbers of this block: no figures kept.
SHARE = 0.5  # of what a Gaussian shows, inside the masks, for it to be the object's
SEEN = 0.02  # contribution [pixels] below which neighbours decide
NEIGHBOURS = 16
FEW, MOST = 0.1, 0.75  # shares of neighbours below and above which they decide
MAPS = 3  # that a rasterizer sums at once
SMALL = 0.01  # share of the largest piece, below which a separate piece is dropped

Chosen = Bool[np.ndarray, "gaussian"]


def lift(
    gaussians: Gaussians,
    cameras: Cameras,
    masks: Float[Tensor, "camera height width"],
    rasterizer: Rasterizer,
) -> Bool[Tensor, "gaussian"]:
    """The Gaussians of one scene (batch 1) that show what the masks (in [0, 1]) cover.

    Only cameras whose mask covers something count. What no camera sees follows its neighbours.
    """
    return lift_all(gaussians, cameras, masks[None], rasterizer)[0]


def lift_all(
    gaussians: Gaussians,
    cameras: Cameras,
    masks: Float[Tensor, "thing camera height width"],
    rasterizer: Rasterizer,
) -> Bool[Tensor, "thing gaussian"]:
    """The same for several things at once."""
    inside = masks > 0.5
    seeing = inside.any(-1).any(-1).to(masks)
    within, total = torch.zeros(2, len(masks), gaussians.count)
    for view in seeing.any(0).nonzero()[:, 0].tolist():
        maps = torch.cat((torch.ones_like(masks[:1, view]), inside[:, view]))
        shown = [
            rasterizer.contributions(gaussians, cameras.select([view]), some[None])[0]
            for some in maps.split(MAPS)
        ]
        everything, *own = torch.cat(shown, 1).T
        total += seeing[:, view, None] * everything
        within += torch.stack(own)
    if not seeing.any():
        return torch.zeros(len(masks), gaussians.count, dtype=torch.bool)
    near = _neighbours(gaussians)
    chosen = [
        _cleaned((all_ > SEEN) & (part > SHARE * all_), all_ > SEEN, near)
        for part, all_ in zip(within.numpy(), total.numpy())
    ]
    return torch.from_numpy(np.stack(chosen))


def _neighbours(gaussians: Gaussians) -> Int[np.ndarray, "gaussian neighbour"]:
    points = gaussians.means[0].numpy()
    count = min(NEIGHBOURS + 1, len(points))
    return cKDTree(points).query(points, count)[1][:, 1:]


def _cleaned(
    chosen: Chosen, seen: Chosen, near: Int[np.ndarray, "gaussian neighbour"]
) -> Chosen:
    """Small holes are filled; single Gaussians and small separate pieces are dropped."""
    among_seen = chosen[near].sum(1) / np.maximum(seen[near].sum(1), 1)
    kept = chosen & (among_seen > FEW) | (among_seen > MOST)
    chosen = np.where(seen, kept, chosen[near].mean(1) > SHARE)
    if not chosen.any():
        return chosen
    source, place = np.nonzero(chosen[near] & chosen[:, None])
    links = coo_matrix(
        (np.ones(len(source)), (source, near[source, place])), (len(chosen),) * 2
    )
    piece = connected_components(links, directed=False)[1]
    sizes = np.bincount(piece[chosen], minlength=piece.max() + 1)
    return chosen & (sizes[piece] >= SMALL * sizes.max())
