"""Masks of views become Gaussians: which of a scene's Gaussians are one object."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians

SHARE = 0.5  # of what a Gaussian shows, inside the masks, for it to be the object's
SEEN = 0.02  # contribution [pixels] below which neighbours decide
NEIGHBOURS = 16
FEW, MOST = 0.1, 0.75  # shares of neighbours below and above which they decide
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
    seeing = [view for view, mask in enumerate(masks) if (mask > 0.5).any()]
    if not seeing:
        return torch.zeros(gaussians.count, dtype=torch.bool)
    inside = (masks[seeing] > 0.5).float()
    weights = torch.stack((inside, torch.ones_like(inside)), 1)
    shown = rasterizer.contributions(gaussians, cameras.select(seeing), weights)[0]
    within, total = shown.T.numpy()
    chosen = (total > SEEN) & (within > SHARE * total)
    return torch.from_numpy(_cleaned(chosen, total > SEEN, gaussians))


def _cleaned(chosen: Chosen, seen: Chosen, gaussians: Gaussians) -> Chosen:
    """Small holes are filled; single Gaussians and small separate pieces are dropped."""
    points = gaussians.means[0].numpy()
    near = cKDTree(points).query(points, min(NEIGHBOURS + 1, len(points)))[1][:, 1:]
    among_seen = chosen[near].sum(1) / np.maximum(seen[near].sum(1), 1)
    kept = chosen & (among_seen > FEW) | (among_seen > MOST)
    chosen = np.where(seen, kept, chosen[near].mean(1) > SHARE)
    if not chosen.any():
        return chosen
    source, place = np.nonzero(chosen[near] & chosen[:, None])
    links = coo_matrix(
        (np.ones(len(source)), (source, near[source, place])), (len(points),) * 2
    )
    piece = connected_components(links, directed=False)[1]
    sizes = np.bincount(piece[chosen], minlength=piece.max() + 1)
    return chosen & (sizes[piece] >= SMALL * sizes.max())
