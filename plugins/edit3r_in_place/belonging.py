"""Which Gaussians of a scene the masks of some of its pictures mean."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.harmonics import dc_to_colour

# The numbers of this block: no figures kept.
SEEN = 0.02  # contribution [pixels] below which a picture says nothing of a Gaussian
SHARE = 0.5  # of what a Gaussian shows, inside the masks, for it to belong to the thing
NEAR = 0.05  # distance [sizes of the thing] that counts as much as `UNLIKE`
UNLIKE = 0.3  # difference of colours
NEIGHBOURS = 8
SWEEPS = 20  # of what neighbours say of each other
LEFT_ALONE = (
    0.7  # share of chosen neighbours from which a Gaussian is a speck of the thing
)
SPECKS = 3  # sweeps: a speck has a few Gaussians
ROUND = 1.0  # sizes of the thing around it, beyond which nothing unseen belongs to it


@dataclass(frozen=True)
class Contribution:
    """What pictures show of each Gaussian of one scene [pixels]."""

    within: Float[Tensor, "gaussian"]  # inside the masks
    total: Float[Tensor, "gaussian"]

    @property
    def seen(self) -> Bool[Tensor, "gaussian"]:
        return self.total > SEEN

    def __add__(self, other: "Contribution") -> "Contribution":
        return Contribution(self.within + other.within, self.total + other.total)


def evidence(
    gaussians: Gaussians,
    cameras: Cameras,
    masks: Float[Tensor, "camera height width"],
    rasterizer: Rasterizer,
) -> Contribution:
    """Of one scene (batch 1) by the masks of all these cameras, in [0, 1]."""
    weights = torch.stack((masks, torch.ones_like(masks)), 1)
    within, total = rasterizer.contributions(gaussians, cameras, weights)[0].T
    return Contribution(within, total)


def belonging(gaussians: Gaussians, shown: Contribution) -> Float[Tensor, "gaussian"]:
    """How much each Gaussian of one scene belongs to the thing, in [0, 1].

    Of what no picture shows, the nearest that one shows decides, by place and colour, and then the
    neighbours among themselves.
    """
    share = shown.within / shown.total.clamp(min=1e-12)
    seen = shown.seen
    inside = seen & (share > SHARE)
    if not bool(inside.any()):
        return torch.zeros_like(share)
    points = gaussians.means[0]
    low, high = (
        points[inside].quantile(torch.tensor([0.02, 0.98]), 0)
        if int(inside.sum()) < 1_000_000
        else (points[inside].amin(0), points[inside].amax(0))
    )
    size = float((high - low).max().clamp(min=1e-9))
    near = ((points > low - ROUND * size) & (points < high + ROUND * size)).all(1)
    unseen = near & ~seen
    result = torch.where(seen, share, 0.0)
    if not bool(unseen.any()):
        return result
    colours = dc_to_colour(gaussians.harmonics[0, :, 0]).clamp(0, 1)
    places = torch.cat((points / (NEAR * size), colours / UNLIKE), 1)
    known, asked = (near & seen).nonzero()[:, 0], unseen.nonzero()[:, 0]
    tree = cKDTree(places[known].numpy())
    _, nearest = tree.query(places[asked].numpy(), workers=-1)
    first = share[known].numpy()[nearest]
    result[asked] = torch.from_numpy(_smoothed(places, known, asked, share, first))
    return result


def with_specks(
    gaussians: Gaussians, chosen: Bool[Tensor, "gaussian"]
) -> Bool[Tensor, "gaussian"]:
    """What is chosen of one scene, and what would be left of it among nothing."""
    points, chosen = gaussians.means[0], chosen.clone()
    for _ in range(SPECKS):
        low, high = points[chosen].amin(0), points[chosen].amax(0)
        margin = NEAR * (high - low).max()
        within = ((points >= low - margin) & (points <= high + margin)).all(1)
        near = within.nonzero()[:, 0]
        asked = near[~chosen[near]]
        if not len(asked):
            break
        tree = cKDTree(points[near].numpy())
        count = min(NEIGHBOURS + 1, len(near))  # the first is itself
        _, found = tree.query(points[asked].numpy(), count, workers=-1)
        share = chosen[near][torch.from_numpy(found.reshape(len(asked), -1))[:, 1:]]
        chosen[asked] = share.float().mean(1) > LEFT_ALONE
    return chosen


def _smoothed(
    places: Tensor, known: Tensor, asked: Tensor, share: Tensor, first: np.ndarray
) -> np.ndarray:
    """The shares of those `asked` once neighbours, `known` ones among them, were averaged."""
    everyone = torch.cat((asked, known))
    tree = cKDTree(places[everyone].numpy())
    count = min(NEIGHBOURS + 1, len(everyone))
    _, near = tree.query(places[asked].numpy(), count, workers=-1)
    near = near.reshape(len(asked), -1)
    rows = np.repeat(np.arange(len(asked)), near.shape[1])
    means = csr_matrix(
        (np.full(near.size, 1 / near.shape[1], np.float32), (rows, near.ravel())),
        (len(asked), len(everyone)),
    )
    fixed = share[known].numpy()
    shares = first.astype(np.float32)
    for _ in range(SWEEPS):
        shares = means @ np.concatenate((shares, fixed))
    return shares
