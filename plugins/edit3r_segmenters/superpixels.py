"""Superpixels of an image, the regions they merge into, and how much each belongs to the
background.
"""

import heapq
from dataclasses import dataclass

import cv2
import numpy as np

COUNT = 350  # superpixels asked for
PALETTE = 40  # colours an image is quantised to for histograms
EDGE_QUANTILE = 0.97  # gradient that counts as a full edge
# colour distance along a path at which two superpixels stop being one surface [CIE Lab units]
COLOUR_REACH = 10.0


@dataclass(frozen=True)
class Superpixels:
    """N superpixels of an image of H x W pixels."""

    labels: np.ndarray  # [H, W] int, 0 to N - 1
    areas: np.ndarray  # [N], pixels
    colours: np.ndarray  # [N, 3], mean CIE Lab
    histograms: np.ndarray  # [N, PALETTE], pixels per palette colour
    pairs: np.ndarray  # [E, 2] int, neighbours, smaller index first
    borders: np.ndarray  # [E], length of their common border [pixels]
    strengths: np.ndarray  # [E], mean edge strength along it, in [0, 1]
    palette_index: np.ndarray  # [H, W] int, palette colour of every pixel
    edges: np.ndarray  # [H, W] float, edge strength in [0, 1]


def superpixels(image: np.ndarray) -> Superpixels:
    """Cut an sRGB image `[H, W, 3]` in [0, 1] into about `COUNT` superpixels, fewer when it is
    tiny.
    """
    height, width = image.shape[:2]
    from skimage.color import rgb2lab  # a run with masks or marks does without both
    from skimage.segmentation import slic

    lab = rgb2lab(image).astype(np.float32)
    wanted = int(np.clip(height * width // 16, 1, COUNT))
    labels = slic(image, wanted, compactness=10, sigma=0.5, start_label=0).astype(
        np.int64
    )
    labels = np.unique(labels, return_inverse=True)[1].reshape(height, width)
    count = labels.max() + 1
    flat = labels.ravel()
    areas = np.bincount(flat, minlength=count).astype(np.float64)
    colours = np.stack(
        [np.bincount(flat, lab[..., c].ravel(), count) / areas for c in range(3)], 1
    )
    palette_index = _quantised(lab)
    histograms = np.bincount(
        flat * PALETTE + palette_index.ravel(), minlength=count * PALETTE
    )
    edges = _edge_strength(lab)
    pairs, borders, strengths = _neighbours(labels, edges)
    return Superpixels(
        labels, areas, colours, histograms.reshape(count, PALETTE).astype(np.float64),
        pairs, borders, strengths, palette_index, edges,
    )  # fmt: skip


def _quantised(lab: np.ndarray) -> np.ndarray:
    """Find the palette index `[H, W]` of a Lab image `[H, W, 3]`: seeded k-means, lightness
    counting half.
    """
    weighted = (lab * np.array([0.5, 1, 1], np.float32)).reshape(-1, 3)
    sample = weighted[:: max(1, len(weighted) // 4000)]
    if len(sample) == 1:  # cv2 takes a single row for a column
        return np.zeros(lab.shape[:2], np.int64)
    clusters = min(PALETTE, len(np.unique(sample, axis=0)))
    cv2.setRNGSeed(0)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 15, 0.5)
    labels = np.zeros(len(sample), np.int32)  # filled in
    _, _, centres = cv2.kmeans(
        sample, clusters, labels, criteria, 1, cv2.KMEANS_PP_CENTERS
    )
    distance = (
        (weighted**2).sum(1, keepdims=True)
        - 2 * weighted @ centres.T
        + (centres**2).sum(1)
    )
    return distance.argmin(1).reshape(lab.shape[:2])


def _edge_strength(lab: np.ndarray) -> np.ndarray:
    """Measure the gradient `[H, W]` of a Lab image after slight smoothing, 1 at its strong
    edges.
    """
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    across, down = (
        cv2.Sobel(smooth, cv2.CV_32F, *way, ksize=3) for way in ((1, 0), (0, 1))
    )
    gradient = (across**2 + down**2).sum(2) ** 0.5
    return np.clip(
        gradient / max(float(np.quantile(gradient, EDGE_QUANTILE)), 1e-3), 0, 1
    )


def _neighbours(
    labels: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find pairs `[E, 2]` of touching superpixels, their border's length `[E]` and mean edge
    strength `[E]`.
    """
    first, second, strength = [], [], []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        touching = labels[a] != labels[b]
        first.append(labels[a][touching])
        second.append(labels[b][touching])
        strength.append(np.maximum(edges[a], edges[b])[touching])
    pairs = np.sort(np.stack([np.concatenate(first), np.concatenate(second)], 1), 1)
    pairs, inverse = np.unique(pairs, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    borders = np.bincount(inverse, minlength=len(pairs)).astype(np.float64)
    return (
        pairs,
        borders,
        np.bincount(inverse, np.concatenate(strength), len(pairs))
        / np.maximum(borders, 1),
    )


@dataclass
class _Region:
    """One region while merging."""

    members: np.ndarray  # [N] bool, its superpixels
    area: float
    colour: np.ndarray  # [3], mean Lab
    histogram: np.ndarray  # [palette], pixels per palette colour
    # region: (border length, mean edge strength)
    neighbours: dict[int, tuple[float, float]]


def merge_tree(superpixels: Superpixels) -> np.ndarray:
    """Merge superpixels region by region; bool `[R, N]`: the members of each superpixel and of each
    merged region.

    Cheapest merges come first. The cost of a merge grows with the difference of colours, the edge
    between the two and the size of the smaller one, so that small or similar neighbours go first
    and objects survive as long as their outline is strong.
    """
    regions = _leaves(superpixels)
    found = [region.members for region in regions.values()]
    queue = [
        (_cost(regions, a, b), a, b) for a, b in map(tuple, superpixels.pairs.tolist())
    ]
    heapq.heapify(queue)
    next_index = len(regions)
    while queue:
        _, a, b = heapq.heappop(queue)
        if a not in regions or b not in regions:
            continue
        regions[next_index] = _merged(regions, a, b)
        _reconnect(regions, a, b, next_index)
        found.append(regions[next_index].members)
        for other in regions[next_index].neighbours:
            heapq.heappush(
                queue, (_cost(regions, other, next_index), other, next_index)
            )
        next_index += 1
    return np.stack(found)


def _leaves(superpixels: Superpixels) -> dict[int, _Region]:
    members = np.eye(len(superpixels.areas), dtype=bool)
    regions = {
        index: _Region(members[index], float(area), colour, histogram, {})
        for index, (area, colour, histogram) in enumerate(
            zip(superpixels.areas, superpixels.colours, superpixels.histograms)
        )
    }
    for (a, b), border, strength in zip(
        superpixels.pairs.tolist(), superpixels.borders, superpixels.strengths
    ):
        regions[a].neighbours[b] = regions[b].neighbours[a] = (
            float(border),
            float(strength),
        )
    return regions


def _cost(regions: dict[int, _Region], a: int, b: int) -> float:
    one, two = regions[a], regions[b]
    colour = float(np.linalg.norm(one.colour - two.colour)) / 25
    overlap = float(
        np.minimum(one.histogram / one.area, two.histogram / two.area).sum()
    )
    _, strength = one.neighbours[b]
    return (colour + (1 - overlap) + strength) * min(one.area, two.area) ** 0.4


def _merged(regions: dict[int, _Region], a: int, b: int) -> _Region:
    one, two = regions[a], regions[b]
    area = one.area + two.area
    neighbours = {}
    for other in (one.neighbours.keys() | two.neighbours.keys()) - {a, b}:
        sides = [
            region.neighbours[other]
            for region in (one, two)
            if other in region.neighbours
        ]
        border = sum(length for length, _ in sides)
        neighbours[other] = (
            border,
            sum(length * strength for length, strength in sides) / border,
        )
    colour = (one.colour * one.area + two.colour * two.area) / area
    return _Region(
        one.members | two.members,
        area,
        colour,
        one.histogram + two.histogram,
        neighbours,
    )


def _reconnect(regions: dict[int, _Region], a: int, b: int, merged: int) -> None:
    for other, edge in regions[merged].neighbours.items():
        regions[other].neighbours.pop(a, None)
        regions[other].neighbours.pop(b, None)
        regions[other].neighbours[merged] = edge
    del regions[a], regions[b]


def background_weights(superpixels: Superpixels) -> np.ndarray:
    """Weigh each superpixel `[N]` by boundary connectivity: 0 surely object, near 1 surely
    background.

    A region that is joined to the image's border along a path of similar colours, and touches much
    of it for its size, is likely background (Zhu et al. 2014, section 3). Unlike a plain border
    prior this lets an object be cut by the image's edge.
    """
    similarity = np.exp(
        -(_geodesic_distances(superpixels) ** 2) / (2 * COLOUR_REACH**2)
    )
    span = similarity.sum(1)  # size of each superpixel's surface
    on_border = similarity[:, _touches_border(superpixels)].sum(1)
    connectivity = on_border / np.sqrt(span)
    return 1 - np.exp(-(connectivity**2) / 2)


def _touches_border(superpixels: Superpixels) -> np.ndarray:
    """Tell which superpixels touch the image's border, bool `[N]`."""
    labels = superpixels.labels
    touching = np.zeros(len(superpixels.areas), dtype=bool)
    touching[np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])] = (
        True
    )
    return touching


def _geodesic_distances(superpixels: Superpixels) -> np.ndarray:
    """Smallest summed colour distance `[N, N]` over all paths; a superpixel's nearest neighbour
    counts as equal.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    count = len(superpixels.areas)
    if len(superpixels.pairs) == 0:
        return np.zeros((count, count))
    first, second = superpixels.pairs.T
    distance = np.linalg.norm(
        superpixels.colours[first] - superpixels.colours[second], axis=1
    )
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, first, distance)
    np.minimum.at(nearest, second, distance)
    # Within one surface the steps are about this long; they must not add up along a path. Zeros
    # mean "no edge".
    steps = np.maximum(distance - nearest.mean(), 1e-6)
    return dijkstra(
        csr_matrix((steps, (first, second)), shape=(count, count)), directed=False
    )
