"""Features of images, and which of them look alike.

SIFT with the square-root descriptor (Arandjelovic and Zisserman 2012) finds them, helped by learned
networks where few of few images match, and looks into tilted images for photos from wide apart.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field

from edit3r.contract import settings as config
from edit3r.contract.reporting import track
from edit3r.kit.weights.find import at_hand, find
from edit3r_geometry import ALIKED
from edit3r_geometry.cameras import CalibratedImage, rays_through
from edit3r_geometry.keypoints import Keypoints, without_standing
from edit3r_geometry.relative_pose import Matches

# The numbers of this block: no figures kept.
LEARNED = "ALIKED + LightGlue"
"""What the learned matches are called."""
LEARNED_NOISE = 4.0
"""How many times less exact than SIFT's the learned points are taken to be where a pose is refined.
No figure kept.
"""
MAX_TILTED_PAIRS = 30
"""Pairs of images that are tilted and matched again; each takes a third of a second."""
MAX_ALL_PAIRS = 10
"""Images up to which every two are matched."""
NEIGHBOURS = 6
"""Others with which each one of more images is matched, at least."""
SAMPLES = 5000
"""Features of all images together that tell which others these are."""
MANY_KEYPOINTS, MANY_SIZE = 2400, 512
"""Most features of one of more images, and the long side at which they are looked for [pixels]."""
MANY_ENLARGEMENT = 1.5
"""How much images are enlarged for that at most: the rest is for two that share little.
No figure kept.
"""
DIRECTIONS = 96
"""Numbers that tell features of more images apart."""
MAX_LEARNED = 7
"""Images up to which learned matches help pairs that few matches join: of more, a row of pairs
places nearly all, and tilted images place more of the rest in less time.
"""
ENOUGH_MATCHES = 250
"""Matches of SIFT that place two views without help."""
SURE_MATCHES = 500
"""Matches of SIFT from which learned ones tell a lens no better: it is the motion that does not. A
rectified pair has 1029, pairs that they helped 294 to 341.
"""
TILTS = ((2**0.5, 0.0), (2.0, 0.0), (2.0, 36.0), (2.0, 144.0))
"""How a surface is looked at from aside: foreshortened so many times, across so many degrees.
No figure kept.
"""
TILTED_RATIO = 0.7
"""Lowe's ratio between tilted images: so many are compared that more would be wrong than right.
No figure kept.
"""
# In pixels of an image with a long side of 512:
_ONE_WITNESS = 2.0  # tilted matches nearer to each other in both images count as one
_ONE_PLACE = 1.5  # features of several tilts nearer to each other are one

# The numbers of this block: no figures kept.
_LARGEST_ENLARGEMENT = 4.0
_CONTRAST = 0.01  # of SIFT; low, because weak features still match when both ways agree
_EDGE = 15.0
# OpenCV's SIFT doubles the image first and forgets that this moves pixel centres
_DOUBLING_SHIFT = 0.25


class FeatureSettings(config.Settings):
    """How features are found and matched."""

    keypoints: int = Field(2500, ge=200, le=20000)
    """most features a photo"""
    detection_size: int = Field(640, ge=128, le=4096)
    """long side at which features are looked for [pixels]; larger finds more"""
    ratio: float = Field(0.85, gt=0, le=1)
    """a match must be this much nearer than its second choice (Lowe's test)"""
    matches: Literal["auto", "sift", "learned"] = "auto"
    """'learned': SIFT's together with ALIKED + LightGlue's, whose weights `edit3r weights get
    aliked-lightglue` fetches; 'auto': so for two of at most seven photos with few matches and for
    pairs whose matches do not tell the lens, where those weights are at hand
    """
    learned_keypoints: int = Field(1024, ge=128, le=4096)
    """most learned features a photo"""


@dataclass(frozen=True)
class FoundFeatures:
    """Features of every image, and which of them look alike."""

    keypoints: tuple[Keypoints, ...]
    # (a, b) with a < b: keypoints of images a and b
    indices: dict[tuple[int, int], Int[np.ndarray, "match 2"]]
    # per image: how many of its first keypoints are SIFT's, the others are learned; (): all
    sift: tuple[int, ...] = ()
    helper: str = ""  # what to call the source of the learned ones
    tilted: bool = False  # some are of tilted images: for photos taken from wide apart

    def without_descriptors(self) -> "FoundFeatures":
        """The same when nothing is to be compared any more."""
        bare = (
            Keypoints(one.points, one.descriptors[:0].copy()) for one in self.keypoints
        )
        return replace(self, keypoints=tuple(bare))

    def learned(self, a: int, b: int) -> Bool[np.ndarray, "match"]:
        """Which matches of images a and b are learned ones."""
        return self.indices[a, b][:, 0] >= (
            self.sift[a] if self.sift else len(self.keypoints[a])
        )

    def matches(self, images: Sequence[CalibratedImage], a: int, b: int) -> Matches:
        """What images a and b have in common, as rays of their cameras."""
        pair, indices = (images[a], images[b]), self.indices[a, b]
        points = (
            self.keypoints[view].points[indices[:, side]]
            for side, view in enumerate((a, b))
        )
        rays_a, rays_b = (
            rays_through(own, image.K) for own, image in zip(points, pair)
        )
        focals = [image.K[axis, axis] for image in pair for axis in (0, 1)]
        height, width = images[b].size
        # A band of two pixels along the longest possible line, over the image's area.
        chance = 2 * np.hypot(height, width) / (height * width)
        learned = self.learned(a, b)
        noise = np.where(learned, LEARNED_NOISE, 1.0) if learned.any() else None
        return Matches(rays_a, rays_b, float(np.mean(focals)), chance, noise)


def find_features(
    images: Sequence[CalibratedImage], settings: FeatureSettings
) -> FoundFeatures:
    """Detect features and match the images two by two; needs no intrinsics.

    Raises MissingDependencyError where learned matches are asked for and their weights are not at
    hand.
    """
    limits = settings.keypoints, settings.detection_size
    if len(images) > MAX_ALL_PAIRS:
        longest = max(max(image.size) for image in images)
        size = min(limits[1], MANY_SIZE, round(MANY_ENLARGEMENT * longest))
        limits = min(limits[0], MANY_KEYPOINTS), size
    keypoints = tuple(
        detect(image.pixels, *limits) for image in track(images, "find features")
    )
    compared = shortened(keypoints) if len(images) > MAX_ALL_PAIRS else keypoints
    pairs = likely_pairs(compared, settings.ratio)
    matches = {
        (a, b): match(compared[a], compared[b], settings.ratio)
        for a, b in track(pairs, "match photos")
    }
    matches = without_standing(keypoints, matches, images)
    found = FoundFeatures(keypoints, matches)
    asked = settings.matches == "learned"
    if settings.matches == "sift" or not (asked or len(images) <= MAX_LEARNED):
        return found
    few = list(found.indices) if asked else _loose_pairs(found)
    if not few:
        return found
    folder = find(ALIKED) if asked else at_hand(ALIKED)
    return (
        found if folder is None else _with_learned(found, few, images, folder, settings)
    )


def _loose_pairs(found: FoundFeatures) -> list[tuple[int, int]]:
    """Pairs with few matches whose images no row of pairs with enough of them joins."""
    group = list(range(len(found.keypoints)))
    for (a, b), indices in found.indices.items():
        if len(indices) >= ENOUGH_MATCHES:
            group = [group[a] if one == group[b] else one for one in group]
    return [(a, b) for a, b in found.indices if group[a] != group[b]]


def shortened(keypoints: Sequence[Keypoints]) -> tuple[Keypoints, ...]:
    """The same features, their descriptors by the directions in which those of all images differ
    most: fewer numbers, which are compared in less time.
    """
    step = -(-sum(map(len, keypoints)) // SAMPLES)
    some = np.concatenate([keys.descriptors[::step] for keys in keypoints])
    _, directions = np.linalg.eigh(some.T @ some)
    short = (keys.descriptors @ directions[:, -DIRECTIONS:] for keys in keypoints)
    return tuple(
        Keypoints(keys.points, few / np.linalg.norm(few, axis=1, keepdims=True))
        for keys, few in zip(keypoints, short)
    )


def likely_pairs(keypoints: Sequence[Keypoints], ratio: float) -> list[tuple[int, int]]:
    """Every two of few images; of many, each with those most like it, and what joins them all.

    A sample of the features tells how alike two images are, as in preemptive matching (Wu 2013).
    """
    every = list(combinations(range(len(keypoints)), 2))
    if len(keypoints) <= MAX_ALL_PAIRS:
        return every
    step = -(-sum(map(len, keypoints)) // SAMPLES)
    samples = [
        Keypoints(keys.points[::step], keys.descriptors[::step]) for keys in keypoints
    ]
    alike = np.zeros((len(keypoints), len(keypoints)))
    for a, b in track(every, "compare photos"):
        alike[a, b] = alike[b, a] = len(match(samples[a], keypoints[b], ratio))
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, :NEIGHBOURS]
    chosen = {
        (min(a, b), max(a, b)) for a, row in enumerate(nearest) for b in row if a != b
    }
    from scipy.sparse.csgraph import minimum_spanning_tree  # for many photos only

    # The more alike, the shorter; a length of 0 would be no edge.
    tree = minimum_spanning_tree(np.triu(1 / (1 + alike), 1)).nonzero()
    return sorted(chosen | set(zip(*(side.tolist() for side in tree))))


def with_tilted(
    found: FoundFeatures,
    images: Sequence[CalibratedImage],
    lost: Collection[int],
    settings: FeatureSettings,
) -> FoundFeatures:
    """Match the `lost` images, and pairs with few matches, again as they look from aside."""
    few = [
        (a not in lost and b not in lost, -len(indices), (a, b))
        for (a, b), indices in found.indices.items()
        if a in lost or b in lost or len(indices) < ENOUGH_MATCHES
    ]
    pairs = [pair for _, _, pair in sorted(few)[:MAX_TILTED_PAIRS]]
    limit = settings.keypoints // 2
    groups = {
        view: [
            found.keypoints[view],
            *detect_tilted(images[view].pixels, limit, settings.detection_size),
        ]
        for view in track(
            sorted({one for pair in pairs for one in pair}), "tilt photos"
        )
    }
    longest = max(max(image.size) for image in images)
    matches = {
        (a, b): match_tilted(groups[a], groups[b], longest)
        for a, b in track(pairs, "match tilted photos")
    }
    keypoints = list(found.keypoints)
    for view, tilted in groups.items():
        for more in tilted[1:]:
            keypoints[view] = keypoints[view].followed_by(more)
    return FoundFeatures(tuple(keypoints), found.indices | matches, tilted=True)


def with_learned(
    found: FoundFeatures,
    images: Sequence[CalibratedImage],
    settings: FeatureSettings,
) -> FoundFeatures:
    """Add learned matches of pairs that may be told more by them; the same where there is no such
    pair, they are there already or not wanted, or their weights are not at hand.
    """
    few = [pair for pair, own in found.indices.items() if len(own) < SURE_MATCHES]
    wanted = few and settings.matches == "auto" and not found.helper
    folder = at_hand(ALIKED) if wanted else None
    return (
        found if folder is None else _with_learned(found, few, images, folder, settings)
    )


def _with_learned(
    found: FoundFeatures,
    pairs: Sequence[tuple[int, int]],
    images: Sequence[CalibratedImage],
    folder: Path,
    settings: FeatureSettings,
) -> FoundFeatures:
    """Add learned matches of `pairs` to those `found`; `folder` holds the weights."""
    # kornia's networks load only where they are used
    from edit3r_geometry.learned import LearnedFeatures

    networks = LearnedFeatures.load(folder, settings.learned_keypoints)
    views = sorted({view for pair in pairs for view in pair})
    more = {
        view: networks.detect(images[view].pixels, settings.detection_size)
        for view in track(views, "find learned features")
    }
    sift = tuple(map(len, found.keypoints))
    indices = dict(found.indices)
    for a, b in track(pairs, "match learned features"):
        own = networks.match(more[a], more[b], (images[a].size, images[b].size))
        indices[a, b] = np.concatenate(
            (indices[a, b], own + np.array([sift[a], sift[b]]))
        )
    keypoints = tuple(
        k.followed_by(more[view]) if view in more else k
        for view, k in enumerate(found.keypoints)
    )
    return FoundFeatures(keypoints, indices, sift, LEARNED)


def detect(
    image: Float[np.ndarray, "height width 3"], limit: int, detection_size: int
) -> Keypoints:
    """At most about `limit` of the strongest features of `image` in [0, 1].

    SIFT looks at the image at a long side of `detection_size` [pixels]; a small one is enlarged, at
    most fourfold, which doubles the matches of images of 256 pixels.
    """
    return _detect(image, _sift(limit), detection_size)


def detect_tilted(
    image: Float[np.ndarray, "height width 3"], limit: int, detection_size: int
) -> list[Keypoints]:
    """As `detect`, once for each of `TILTS`: features of the image as seen from aside.

    After ASIFT (Morel and Yu 2009): SIFT finds the same features from other sides only up to about
    30 degrees; an image that is foreshortened first looks like the other photo.
    """
    found = []
    for tilt, across in TILTS:
        tilted = cv2.AffineFeature.create(_sift(limit))
        tilted.setViewParams([tilt], [across])
        found.append(_detect(image, tilted, detection_size))
    return found


def _sift(limit: int) -> cv2.SIFT:
    return cv2.SIFT.create(limit, contrastThreshold=_CONTRAST, edgeThreshold=_EDGE)


def _detect(
    image: Float[np.ndarray, "height width 3"],
    detector: cv2.Feature2D,
    detection_size: int,
) -> Keypoints:
    grey = cv2.cvtColor(
        (np.clip(image, 0, 1) * 255).round().astype(np.uint8), cv2.COLOR_RGB2GRAY
    )
    scale = min(detection_size / max(grey.shape), _LARGEST_ENLARGEMENT)
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    filtering = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    found, descriptors = detector.detectAndCompute(
        cv2.resize(grey, size, interpolation=filtering), None
    )
    if not found:
        return Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    # SIFT counts from pixel centres, we from the corner; the two axes were scaled by slightly
    # different whole sizes.
    pixels = np.array([point.pt for point in found]) + 0.5 - _DOUBLING_SHIFT
    points = pixels * np.array(grey.shape[::-1]) / np.array(size)
    return Keypoints(points, _square_root(descriptors))


def _square_root(
    descriptors: Float[np.ndarray, "point 128"],
) -> Float[np.ndarray, "point 128"]:
    """The Hellinger kernel: the root of shares of the sum; the result has unit length."""
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
    return np.sqrt(descriptors / total).astype(np.float32)


def match(a: Keypoints, b: Keypoints, ratio: float) -> Int[np.ndarray, "match 2"]:
    """Pairs of indices that choose each other and whose second choice is clearly worse.

    A match stays when its descriptor distance is below `ratio` times that to the second-best in `b`
    (Lowe's test).
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), int)
    similarity = a.descriptors @ b.descriptors.T
    most_like_b = similarity.max(axis=0)
    rows, best = np.arange(len(a)), similarity.argmax(axis=1)
    first = similarity[rows, best]
    similarity[rows, best] = -1
    second = similarity.max(axis=1)
    distinct = _distance(first) < ratio * _distance(second)
    chosen = np.flatnonzero(distinct & (first == most_like_b[best]))
    pairs = np.stack([chosen, best[chosen]], axis=1)
    return _without_duplicates(a, b, pairs)


def match_tilted(
    a: Sequence[Keypoints], b: Sequence[Keypoints], longest: int
) -> Int[np.ndarray, "match 2"]:
    """Matches of every group of features of one image with every group of another.

    Indices count through the groups. Features at one place are one: that of the first group.
    `longest` is the longer side of the images [pixels].
    """
    unit = longest / 512
    starts = [np.cumsum([0, *map(len, groups)]) for groups in (a, b)]
    found = [
        match(one, other, TILTED_RATIO) + np.array([starts[0][i], starts[1][j]])
        for i, one in enumerate(a)
        for j, other in enumerate(b)
    ]
    first = [_first_at_its_place(groups, _ONE_PLACE * unit) for groups in (a, b)]
    pairs = np.concatenate(found)
    same = np.stack([first[side][pairs[:, side]] for side in (0, 1)], axis=1)
    points = [np.concatenate([group.points for group in groups]) for groups in (a, b)]
    cells = [
        np.floor(points[side][same[:, side]] / (_ONE_WITNESS * unit)) for side in (0, 1)
    ]
    _, kept = np.unique(np.concatenate(cells, axis=1), axis=0, return_index=True)
    return same[np.sort(kept)]


def _first_at_its_place(
    groups: Sequence[Keypoints], width: float
) -> Int[np.ndarray, "point"]:
    """For each feature of all groups the first one in its cell, `width` pixels wide."""
    points = np.concatenate([group.points for group in groups])
    cells = np.floor(points / width)
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return first[cell.ravel()]


def _distance(similarity: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Distance of unit vectors; never quite 0, so that no perfect match beats another."""
    return np.sqrt(np.maximum(2 - 2 * similarity, 1e-6))


def _without_duplicates(
    a: Keypoints, b: Keypoints, pairs: Int[np.ndarray, "match 2"]
) -> Int[np.ndarray, "distinct 2"]:
    """One match for each position: SIFT reports a point once per dominant orientation."""
    positions = np.round(
        np.concatenate([a.points[pairs[:, 0]], b.points[pairs[:, 1]]], axis=1), 1
    )
    _, kept = np.unique(positions, axis=0, return_index=True)
    return pairs[np.sort(kept)]
