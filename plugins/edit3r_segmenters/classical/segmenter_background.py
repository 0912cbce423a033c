"""How much each superpixel belongs to the background: boundary connectivity (Zhu et al. 2014, section 3).

A region that is joined to the picture's border along a path of similar colours, and touches much of it for its size,
is likely background. Unlike a plain border prior this lets an object be cut by the picture's edge.
"""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from edit3r_segmenters.classical.segmenter_superpixels import Superpixels

COLOUR_REACH = 10.0  # colour distance along a path at which two superpixels stop being one surface [CIE Lab units]


def background_weights(superpixels: Superpixels) -> np.ndarray:
    """`[N]` in [0, 1): 0 surely object, near 1 surely background."""
    similarity = np.exp(-(_geodesic_distances(superpixels) ** 2) / (2 * COLOUR_REACH**2))
    span = similarity.sum(1)  # size of each superpixel's surface
    on_border = similarity[:, _touches_border(superpixels)].sum(1)
    connectivity = on_border / np.sqrt(span)
    return 1 - np.exp(-(connectivity**2) / 2)


def _touches_border(superpixels: Superpixels) -> np.ndarray:
    labels = superpixels.labels
    touching = np.zeros(len(superpixels.areas), dtype=bool)
    touching[np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])] = True
    return touching


def _geodesic_distances(superpixels: Superpixels) -> np.ndarray:
    """`[N, N]` smallest summed colour distance over all paths; each superpixel's nearest neighbour counts as equal."""
    count = len(superpixels.areas)
    if len(superpixels.pairs) == 0:
        return np.zeros((count, count))
    first, second = superpixels.pairs.T
    distance = np.linalg.norm(superpixels.colours[first] - superpixels.colours[second], axis=1)
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, first, distance)
    np.minimum.at(nearest, second, distance)
    # Within one surface the steps are about this long; they must not add up along a path. Zeros mean "no edge".
    steps = np.maximum(distance - nearest.mean(), 1e-6)
    return dijkstra(csr_matrix((steps, (first, second)), shape=(count, count)), directed=False)
