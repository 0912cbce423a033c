"""Answers to marks without a network: GrabCut (Rother et al. 2004) in windows of several sizes, and
the regions of a graph segmentation (Felzenszwalb and Huttenlocher 2004) at several scales.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from edit3r_select.cues import Appearance, Box, Click

LONGER = 256  # longer side on which is computed [pixels]
WINDOWS = (0.15, 0.3, 0.55, 1.0)  # around the clicks [longer sides]
SCALES = (100, 300, 800, 2000)  # of the graph segmentation: larger regions
CORE = 0.4  # share of a box's sides in which an ellipse surely is the thing: else all may go
LEAST = 60  # pixels of one of its regions
MARGIN = 0.3  # what is looked at beside what may be the thing [longer sides]
ROUNDS = 3
SURE = 4.0  # logit of every pixel: nothing was measured
MIN_SAMPLES = 16  # pixels that a colour model needs on either side


class GrabCut:
    """Answers marks on one photo, as a SAM's `ask` does."""

    def __init__(self, photo: Appearance) -> None:
        height, width = photo.size
        scale = min(1.0, LONGER / max(height, width))
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        self.small = Appearance(
            cv2.resize(photo.rgb, size, interpolation=cv2.INTER_AREA)
        )
        self._regions: dict[int, np.ndarray] = {}

    def ask(
        self,
        clicks: Sequence[Click],
        box: Box | None = None,
        before: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logits `[n, h, w]` of several masks, and zeros for what they expect of themselves."""
        told = [(self.small.pixel(place), wanted) for place, wanted in clicks]
        if box is not None:
            nothing = np.zeros(self.small.size, np.uint8)
            masks = [self._in(self._boxed(box), told)]
            masks += [self._ellipse(nothing, box, 1.0, 1) > 0]
        elif before is not None:
            masks = [self._near(before, told, reach) for reach in WINDOWS[:3]]
        else:
            masks = [self._in(self._window(told, size), told) for size in WINDOWS]
            masks += [self._region(told, scale) for scale in SCALES]
        logits = np.where(np.stack(masks), SURE, -SURE).astype(np.float32)
        return logits, np.zeros(len(masks))

    def _window(self, told: list, size: float) -> np.ndarray:
        """Trimap of a disc around the places on the thing: probably the thing in its half."""
        distance = self._distance([place for place, wanted in told if wanted])
        reach = size * max(self.small.size) / 2
        trimap = np.full(self.small.size, cv2.GC_BGD, np.uint8)
        trimap[distance <= reach] = cv2.GC_PR_BGD
        trimap[distance <= 0.5 * reach] = cv2.GC_PR_FGD
        return trimap

    def _boxed(self, box: Box) -> np.ndarray:
        top, left = self.small.pixel(box[:2])
        bottom, right = self.small.pixel((box[0] + box[2], box[1] + box[3]))
        trimap = np.full(self.small.size, cv2.GC_BGD, np.uint8)
        trimap[top : bottom + 1, left : right + 1] = cv2.GC_PR_FGD
        self._ellipse(trimap, box, CORE, cv2.GC_FGD)
        return trimap

    def _ellipse(
        self, canvas: np.ndarray, box: Box, share: float, value: int
    ) -> np.ndarray:
        """Draw the ellipse that fills a share of a box's sides."""
        height, width = canvas.shape
        x, y, w, h = box
        middle = ((x + w / 2) * width, (y + h / 2) * height)
        sides = (max(1.0, share * w * width), max(1.0, share * h * height))
        return cv2.ellipse(canvas, (middle, sides, 0.0), value, cv2.FILLED)

    def _near(self, before: np.ndarray, told: list, size: float) -> np.ndarray:
        """The answer before, changed only around the last click."""
        height, width = self.small.size
        known = cv2.resize(np.float32(before), (width, height)) > 0
        place, wanted = told[-1]
        trimap = np.where(known, cv2.GC_FGD, cv2.GC_BGD).astype(np.uint8)
        near = self._distance([place]) <= size * max(self.small.size) / 2
        trimap[near] = np.where(known, cv2.GC_PR_FGD, cv2.GC_PR_BGD)[near]
        closer = self._distance([place]) <= size * max(self.small.size) / 4
        trimap[closer] = cv2.GC_PR_FGD if wanted else cv2.GC_PR_BGD
        return self._in(trimap, told, whole=True)

    def _in(self, trimap: np.ndarray, told: list, whole: bool = False) -> np.ndarray:
        """Cut along colours, places as they are told; what joins no place on the thing goes."""
        radius = max(1, round(0.012 * max(self.small.size)))
        for (row, column), wanted in told:
            value = cv2.GC_FGD if wanted else cv2.GC_BGD
            cv2.circle(trimap, (column, row), radius, value, cv2.FILLED)
        inside = self._cut(trimap)
        places = [place for place, wanted in told if wanted]
        return inside if whole or not places else _joining(inside, places)

    def _cut(self, trimap: np.ndarray) -> np.ndarray:
        """What a trimap becomes by the colours in and around what may be the thing."""
        height, width = self.small.size
        x, y, w, h = cv2.boundingRect((trimap != cv2.GC_BGD).astype(np.uint8))
        margin = round(MARGIN * max(height, width))
        rows = slice(max(0, y - margin), min(height, y + h + margin))
        columns = slice(max(0, x - margin), min(width, x + w + margin))
        labels = np.ascontiguousarray(trimap[rows, columns])
        inside = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
        if min(inside.sum(), (~inside).sum()) >= MIN_SAMPLES:
            cv2.setRNGSeed(0)  # its colour models start from k-means
            models = np.zeros((1, 65)), np.zeros((1, 65))
            part = np.ascontiguousarray(self.small.rgb[rows, columns])
            cv2.grabCut(part, labels, None, *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
            inside = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))
        whole = np.zeros(self.small.size, bool)
        whole[rows, columns] = inside
        return whole

    def _region(self, told: list, scale: int) -> np.ndarray:
        """The regions at places on the thing."""
        if scale not in self._regions:
            cut = cv2.ximgproc.segmentation.createGraphSegmentation(0.8, scale, LEAST)
            self._regions[scale] = cut.processImage(self.small.lab.astype(np.uint8))
        labels = self._regions[scale]
        wanted = [labels[place] for place, inside in told if inside]
        return _joining(np.isin(labels, wanted), [p for p, inside in told if inside])

    def _distance(self, places: list) -> np.ndarray:
        away = np.ones(self.small.size, np.uint8)
        for place in places:
            away[place] = 0
        return cv2.distanceTransform(away, cv2.DIST_L2, 3)


def _joining(mask: np.ndarray, places: list) -> np.ndarray:
    """The pieces of a bool mask at places, without small holes."""
    labels = cv2.connectedComponents(mask.astype(np.uint8))[1]
    kept = np.isin(labels, [labels[place] for place in places if labels[place]])
    count, gaps, stats, _ = cv2.connectedComponentsWithStats((~kept).astype(np.uint8))
    small = [one for one in range(1, count) if stats[one, 4] < 0.01 * kept.sum()]
    return kept | np.isin(gaps, small)
