"""Whether the pictures of a 2D editor lie on their photos, and what to do where they do not.

Image models shift, zoom, turn, mirror, swap or black out what they return. Where one similarity (or
affine map) explains that, it is undone; all else is named. Edges are compared, not colours: an edit
may change every colour of a photo and still lie on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from edit3r.kit.photos.images import Pixels, to_bytes


@dataclass(frozen=True)
class AlignmentSettings:
    """What decides whether an edit lies on its photo.

    Chosen by hand, but for `ratio`; nobody wrote down on what. Of 160 cases on four pairs, 92 % are
    put right or named (docs/notes/ledger.md).
    """

    # the pictures that are compared
    max_side: int = 384
    """longer side of the copies that are compared [pixels]"""
    min_side: int = 32
    """shorter side of a copy below which no edit is judged [pixels]"""
    uniform_range: int = 8
    """range of each channel up to which pixels count as one colour [levels of 255]"""
    black_level: int = 16
    """brightest channel of a picture of one colour that is called black [levels of 255]"""
    paper_sigma: float = 3.0
    """of the Gaussian whose mean is the paper beside a drawn line [pixels]"""
    # tiles, whose shifts phase correlation measures
    min_tile_side: int = 40
    """[pixels]"""
    max_tiles: int = 4
    """along the longer side; along the other one fewer"""
    min_response: float = 0.1
    """of the phase correlation, in [0, 1], below which a tile is left out"""
    min_structure: float = 0.5
    """standard deviation of its edges below which a tile is left out"""
    max_shift: float = 0.4
    """with which a tile counts as in place [pixels]"""
    max_shift_undone: float = 0.8
    """the same once a motion was undone, which is known less exactly [pixels]"""
    min_in_place: float = 0.5
    """share of the tiles above which an edit lies on a photo"""
    # when a motion is believed
    features: int = 1500
    """SIFT features of a picture, at most"""
    ratio: float = 0.8
    """distance of the nearest feature over that of the second up to which they match (Lowe 2004)"""
    max_residual: float = 1.5
    """of a match that agrees with a map, in RANSAC [pixels]"""
    min_matches: int = 12
    """that must agree with a map"""
    affine_gain: float = 1.25
    """how many times the matches of a similarity an affine map must explain to be taken instead"""
    min_motion: float = 0.6
    """of a corner, below which nothing moved [pixels]"""
    min_gain: float = 0.25
    """share of the tiles that undoing a motion must bring in place"""
    sure_in_place: float = 0.9
    """share of the tiles in place from which no other photo is tried"""
    min_overlap: float = 0.15
    """share of its photo that an edit must show for a motion to be looked at"""
    min_shown: float = 0.65
    """share of its photo that an edit must show to be moved back"""
    fill_sigma: float = 0.02
    """of the Gaussian that smooths the change carried into what left the picture [longer sides]"""
    # when an edit is at fault
    min_bar: float = 0.03
    """share of a side from which a border of one colour is a bar"""
    min_likeness: float = 0.25
    """correlation of edges below which an edit shows nothing of its photo"""
    min_displacement: float = 1.5
    """median motion of matches that no map explains, above which it is named [pixels]"""


LIMITS = AlignmentSettings()

Edges = Float[np.ndarray, "height width"]
Map = Float[np.ndarray, "2 3"]


@dataclass(frozen=True)
class AlignedEdit:
    """The pictures of an editor as they lie on their photos, and what was found."""

    images: Float[Tensor, "batch view 3 height width"]
    moved: tuple[str, ...] = ()  # what was undone, a clause for each picture
    faults: tuple[str, ...] = ()  # what could not be, a clause for each picture


def align_edit(
    photos: Float[Tensor, "batch view 3 height width"],
    edits: Float[Tensor, "batch view 3 height width"],
    names: Sequence[str],
    confined: bool,
) -> AlignedEdit:
    """The edits moved to where their photos are.

    `confined`: only a part of them is used, so the rest may show anything.
    """
    images, moved, faults = edits, [], []
    for scene in range(len(photos)):
        shown = [_Picture(to_bytes(image)) for image in photos[scene]]
        for view, name in enumerate(names):
            if torch.equal(photos[scene, view], edits[scene, view]):
                continue
            judged = _judged(_Picture(to_bytes(edits[scene, view])), shown, view)
            if isinstance(judged, _Motion):
                images = images.clone() if images is edits else images
                images[scene, view] = _undone(
                    judged, photos[scene, view], images[scene, view]
                )
                moved.append(f"{name} was {judged.in_words}")
            elif judged and not (confined and judged.of_all):
                faults.append(judged.text.format(name=name, other=names[judged.other]))
    return AlignedEdit(images, tuple(moved), tuple(faults))


@dataclass(frozen=True)
class _Fault:
    """Why a picture cannot be put in place."""

    text: str  # about {name}, and perhaps the photo {other}
    other: int = 0
    of_all: bool = False  # it says nothing where only a part of the picture is used


ONE_COLOUR_ONLY = _Fault("the editor returned a picture of one colour for {name}")
BLACK_ONLY = _Fault("the editor returned a black picture for {name}")
UNLIKE = _Fault("the edit of {name} shows nothing of its photo", of_all=True)


@dataclass(frozen=True, eq=False)
class _Picture:
    """A picture, and what is compared of it."""

    pixels: Pixels
    is_drawn: bool = False  # its lines stand where a photo has edges

    @property
    def scale(self) -> float:
        return min(1.0, LIMITS.max_side / max(self.pixels.shape[:2]))

    @cached_property
    def small(self) -> Pixels:
        height, width = self.pixels.shape[:2]
        size = (round(width * self.scale), round(height * self.scale))
        return cv2.resize(self.pixels, size, interpolation=cv2.INTER_AREA)

    @cached_property
    def edges(self) -> Edges:
        """How much the colour changes, its root: faint edges count as well. Of a drawing, how
        dark its lines are: a line has two edges, beside that of the photo.
        """
        smooth = cv2.GaussianBlur(self.small.astype(np.float32), (0, 0), 1.0)
        if self.is_drawn:
            grey = smooth.mean(-1)
            return np.sqrt(
                (cv2.GaussianBlur(grey, (0, 0), LIMITS.paper_sigma) - grey).clip(0)
            )
        across, down = (cv2.Sobel(smooth, cv2.CV_32F, *way) for way in ((1, 0), (0, 1)))
        return np.sqrt(np.sqrt((across**2 + down**2).max(-1)))

    @cached_property
    def features(self) -> tuple:
        return _features(cv2.cvtColor(self.small, cv2.COLOR_RGB2GRAY))

    @cached_property
    def edge_features(self) -> tuple:
        """For edits that turn light to dark."""
        levels = 255 * self.edges / max(float(self.edges.max()), 1e-6)
        return _features(levels.astype(np.uint8))

    @property
    def spread(self) -> int:
        """Range of the channel that has most."""
        return int(np.ptp(self.small.reshape(-1, 3), axis=0).max())

    def mirrored(self) -> "_Picture":
        return replace(self, pixels=np.ascontiguousarray(self.pixels[:, ::-1]))


@dataclass(frozen=True)
class _Motion:
    """Where the points of a photo lie in its edit, which is mirrored first where it was."""

    matrix: Map  # photo to edit [pixels of the small copies]
    scale: float  # small copy over picture
    size: tuple[int, int]  # (height, width) of the small copies
    mirrored: bool = False
    fits: float = 0.0  # share of the tiles that lie in place once it is undone

    @property
    def at_full_size(self) -> Map:
        """The same in pixels of the pictures."""
        matrix = self.matrix.copy()
        centre = 0.5 * (1 / self.scale - 1)  # of the first pixel of the small copy
        matrix[:, 2] = (
            matrix[:, 2] / self.scale + centre - matrix[:, :2] @ [centre, centre]
        )
        return matrix

    @property
    def is_none(self) -> bool:
        """Whether even the corners stayed where they were."""
        height, width = self.size
        corners = np.array([(x, y) for x in (0, width) for y in (0, height)])
        moved = corners @ self.matrix[:, :2].T + self.matrix[:, 2] - corners
        return not self.mirrored and float(np.abs(moved).max()) < LIMITS.min_motion

    @property
    def in_words(self) -> str:
        """What happened to the picture, in words."""
        height, width = self.size
        linear = self.matrix[:, :2]
        middle = np.array([(width - 1) / 2, (height - 1) / 2])
        right, down = (linear @ middle + self.matrix[:, 2] - middle) / self.scale
        zoom = np.sqrt(abs(np.linalg.det(linear)))
        turn = np.degrees(np.arctan2(linear[1, 0], linear[0, 0]))
        sizes = np.linalg.svd(linear)[1]
        parts = ["mirrored"] if self.mirrored else []
        if sizes[0] > 1.02 * sizes[1]:
            parts.append(f"squashed by {sizes[0] / sizes[1]:.2f}")
        if abs(zoom - 1) > 0.002:
            parts.append(f"zoomed {zoom:.3f} times")
        if abs(turn) > 0.1:
            parts.append(f"turned by {turn:.1f} degrees")
        if max(abs(right), abs(down)) > 0.3 or not parts:
            aside = "right" if right > 0 else "left"
            along = "down" if down > 0 else "up"
            parts.append(
                f"shifted by {abs(right):.1f} px to the {aside} and {abs(down):.1f} px {along}"
            )
        return ", ".join(parts)


def _judged(
    edit: _Picture, photos: Sequence[_Picture], view: int
) -> _Motion | _Fault | None:
    """The motion to undo, what is wrong, or None where the edit lies on its photo."""
    photo = photos[view]
    if (
        min(photo.small.shape[:2]) < LIMITS.min_side
        or photo.spread <= LIMITS.uniform_range
    ):
        return None
    if edit.spread <= LIMITS.uniform_range:
        return BLACK_ONLY if edit.small.max() <= LIMITS.black_level else ONE_COLOUR_ONLY
    if _share_in_place(photo.edges, edit.edges) > LIMITS.min_in_place:
        return _bar(edit, photo)
    drawn = replace(edit, is_drawn=True)
    if (
        _share_in_place(photo.edges, drawn.edges, LIMITS.max_shift_undone)
        > LIMITS.min_in_place
    ):
        return None
    for seen in (edit, drawn):
        explained = _explained(seen, photo)
        if explained is not None:
            return _believed(explained, seen, photos, view)
    return _of_another(edit, photos, view, 0.0) or _unexplained(edit, photo)


def _believed(
    explained: _Motion | _Fault, edit: _Picture, photos: Sequence[_Picture], view: int
) -> _Motion | _Fault | None:
    """What explains an edit; None where undoing it gains little, and a fault where the edit fits
    another photo better.
    """
    if isinstance(explained, _Fault):
        return explained
    as_it_is = _share_in_place(photos[view].edges, edit.edges, LIMITS.max_shift_undone)
    if explained.is_none or explained.fits < as_it_is + LIMITS.min_gain:
        return None
    if explained.fits >= LIMITS.sure_in_place:
        return explained
    return _of_another(edit, photos, view, explained.fits) or explained


def _of_another(
    edit: _Picture, photos: Sequence[_Picture], view: int, least: float
) -> _Fault | None:
    """That it shows another photo, where it fits that better than `least` [share of tiles]."""
    for other, its in enumerate(photos):
        if other == view:
            continue
        fits = _share_in_place(its.edges, edit.edges)
        if fits <= LIMITS.min_in_place:
            motion = _explained(edit, its)
            fits = motion.fits if isinstance(motion, _Motion) else 0.0
        if fits > max(least, LIMITS.min_in_place):
            return _Fault("the edit of {name} shows the photo {other}", other)
    return None


def _bar(edit: _Picture, photo: _Picture) -> _Fault | None:
    """That a straight part of the picture is one colour, which the photo is not there."""
    for turns, side in enumerate(("top", "right", "bottom", "left")):
        pixels, before = (np.rot90(one.small, turns) for one in (edit, photo))
        if np.ptp(pixels[0], axis=0).max() > 2 * LIMITS.uniform_range:
            continue
        pixels = pixels.astype(np.int16)
        one_colour = (
            np.abs(pixels - pixels[0, 0]).max(-1) <= LIMITS.uniform_range
        ).mean(1)
        rows = int(np.argmin(one_colour > 0.99))
        # An object before a plain background touches the last row of it in few places.
        cut = rows + 2 < len(one_colour) and one_colour[rows + 2] < 0.4
        if (
            cut
            and rows > LIMITS.min_bar * len(one_colour)
            and np.ptp(before[:rows], axis=(0, 1)).max() > 4 * LIMITS.uniform_range
        ):
            share = f"{rows / len(one_colour):.0%} of the edit of {{name}}"
            return _Fault(f"the {side} {share} are one colour", of_all=True)
    return None


def _explained(edit: _Picture, photo: _Picture) -> _Motion | _Fault | None:
    """The motion that brought the edit away from its photo, or that too little of it is left."""
    for mirrored in (False, True):
        matrix = _map_between(photo, edit.mirrored() if mirrored else edit)
        if matrix is None:
            continue
        motion = _Motion(matrix, photo.scale, photo.edges.shape, mirrored)
        there = _warped(edit.edges[:, ::-1] if mirrored else edit.edges, matrix)
        shown = _warped(np.ones_like(edit.edges), matrix) > 0.99
        if shown.mean() < LIMITS.min_overlap:
            continue
        fits = _share_in_place(
            photo.edges * shown, there * shown, LIMITS.max_shift_undone
        )
        if fits <= LIMITS.min_in_place:
            continue
        if shown.mean() < LIMITS.min_shown:
            share = f"{shown.mean():.0%} of its photo only ({motion.in_words})"
            return _Fault(f"the edit of {{name}} shows {share}")
        return replace(motion, fits=fits)
    return None


def _unexplained(edit: _Picture, photo: _Picture) -> _Fault | None:
    """What is wrong with an edit that no map brings to its photo; None where nobody can tell."""
    here, there = _matched(photo.features, edit.features)
    away = np.linalg.norm(there - here, axis=1)
    near = away[away < 0.2 * LIMITS.max_side]
    if (
        len(near) >= 2 * LIMITS.min_matches
        and len(near) > 0.5 * len(away)
        and np.median(near) > LIMITS.min_displacement
    ):
        pixels = np.median(near) / photo.scale
        return _Fault(
            f"the edit of {{name}} lies about {pixels:.0f} px beside its photo"
        )
    seen = (edit.edges, replace(edit, is_drawn=True).edges)
    near = (
        np.sum(_shifts(photo.edges, edges) < 4 * LIMITS.max_shift) for edges in seen
    )
    likeness = (_likeness(photo.edges, edges) for edges in seen)
    return UNLIKE if max(near) < 2 and max(likeness) < LIMITS.min_likeness else None


# ---- comparing ----


def _share_in_place(
    photo: Edges, edit: Edges, limit: float = LIMITS.max_shift
) -> float:
    """Share of the tiles that lie where they were, 0 where no tile tells."""
    shifts = _shifts(photo, edit)
    return float(np.mean(shifts <= limit)) if len(shifts) else 0.0


def _shifts(photo: Edges, edit: Edges) -> Float[np.ndarray, "tile"]:
    """How far each tile that shows something lies from where it was [pixels]."""
    if photo.shape != edit.shape:
        return np.zeros(0)
    height, width = photo.shape
    rows, columns = (
        max(1, min(most, side // LIMITS.min_tile_side))
        for most, side in ((LIMITS.max_tiles - 1, height), (LIMITS.max_tiles, width))
    )
    tall, wide = height // rows, width // columns
    window = cv2.createHanningWindow((wide, tall), cv2.CV_32F)
    shifts = []
    for top in range(0, rows * tall, tall):
        for left in range(0, columns * wide, wide):
            place = (slice(top, top + tall), slice(left, left + wide))
            one, other = photo[place], edit[place]
            if min(one.std(), other.std()) < LIMITS.min_structure:
                continue
            shift, response = cv2.phaseCorrelate(
                one - one.mean(), other - other.mean(), window
            )
            if response > LIMITS.min_response:
                shifts.append(np.hypot(shift[0], shift[1]))
    return np.array(shifts)


def _likeness(first: Edges, second: Edges) -> float:
    """Correlation of the edges of two pictures, in [-1, 1]."""
    if first.shape != second.shape:
        return 0.0
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def _features(grey: UInt8[np.ndarray, "height width"]) -> tuple:
    # Otherwise features lie a quarter of a pixel off, as a mirrored picture shows.
    detector = cv2.SIFT.create(LIMITS.features, enable_precise_upscale=True)
    keypoints, descriptors = detector.detectAndCompute(grey, None)
    points = np.array([one.pt for one in keypoints], np.float32).reshape(-1, 2)
    return points, descriptors


def _matched(first: tuple, second: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Places of the features that two pictures have in common."""
    (here, descriptors), (there, others) = first, second
    if min(len(here), len(there)) < 2:
        return np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32)
    pairs = cv2.BFMatcher().knnMatch(descriptors, others, k=2)
    matches = [
        best
        for best, second_best in pairs
        if best.distance < LIMITS.ratio * second_best.distance
    ]
    return (
        here[[one.queryIdx for one in matches]].reshape(-1, 2),
        there[[one.trainIdx for one in matches]].reshape(-1, 2),
    )


def _map_between(photo: _Picture, edit: _Picture) -> Map | None:
    """The similarity, or where that explains much less the affine map, from photo to edit."""
    for kind in ("edge_features",) if edit.is_drawn else ("features", "edge_features"):
        here, there = _matched(getattr(photo, kind), getattr(edit, kind))
        if len(here) < LIMITS.min_matches:
            continue
        similar, affine = (
            _fitted(find, here, there)
            for find in (cv2.estimateAffinePartial2D, cv2.estimateAffine2D)
        )
        best = affine if affine[1] > LIMITS.affine_gain * similar[1] else similar
        # A mirrored picture is found mirrored back; and nothing shrinks to a point.
        if best[1] >= LIMITS.min_matches and np.linalg.det(best[0][:, :2]) > 0.01:
            return best[0]
    return None


def _fitted(find, here: np.ndarray, there: np.ndarray) -> tuple[Map, int]:
    """A map by RANSAC, and how many matches agree with it."""
    cv2.setRNGSeed(0)
    matrix, inliers = find(
        here,
        there,
        ransacReprojThreshold=LIMITS.max_residual,
        maxIters=3000,
        confidence=0.999,
    )
    return (np.eye(2, 3), 0) if matrix is None else (matrix, int(inliers.sum()))


# ---- moving back ----


def _warped(image: np.ndarray, matrix: Map) -> np.ndarray:
    """What of an edit lies where each pixel of the photo is; 0 where nothing does."""
    height, width = image.shape[:2]
    flags = cv2.WARP_INVERSE_MAP | cv2.INTER_CUBIC
    return cv2.warpAffine(
        np.ascontiguousarray(image), matrix, (width, height), flags=flags
    )


def _undone(
    motion: _Motion,
    photo: Float[Tensor, "3 height width"],
    edit: Float[Tensor, "3 height width"],
) -> Float[Tensor, "3 height width"]:
    """The edit where its photo is; what left the picture is the photo, changed as beside it."""
    before, after = (
        one.movedim(0, -1).numpy(force=True).astype(np.float32) for one in (photo, edit)
    )
    if motion.mirrored:
        after = after[:, ::-1]
    matrix = motion.at_full_size
    shown = _warped(np.ones(before.shape[:2], np.float32), matrix) > 0.99
    there = _warped(after, matrix)
    filled = before + _change_beside(before, there, shown, matrix)
    result = np.where(shown[..., None], there, filled).clip(0, 1)
    return torch.from_numpy(result).movedim(-1, 0).to(edit)


def _change_beside(
    before: Float[np.ndarray, "height width 3"],
    after: Float[np.ndarray, "height width 3"],
    shown: Bool[np.ndarray, "height width"],
    matrix: Map,
) -> Float[np.ndarray, "height width 3"]:
    """The smoothed change at the nearest place that the edit shows, for each pixel."""
    height, width = shown.shape
    reach = LIMITS.fill_sigma * max(height, width)
    weight = shown.astype(np.float32)
    change = cv2.GaussianBlur((after - before) * weight[..., None], (0, 0), reach)
    change /= cv2.GaussianBlur(weight, (0, 0), reach)[..., None] + 1e-6
    rows, columns = np.mgrid[:height, :width]
    places = np.stack((columns, rows), -1) @ matrix[:, :2].T + matrix[:, 2]
    inside = places.clip(0, [width - 1, height - 1]) - matrix[:, 2]
    nearest = (inside @ np.linalg.inv(matrix[:, :2]).T).astype(np.float32)
    return cv2.remap(
        change,
        nearest[..., 0],
        nearest[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
