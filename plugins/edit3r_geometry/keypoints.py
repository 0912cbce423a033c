"""Features of images, and those that stand still on all photos: the bars of a screen, a watermark,
the photographer's own shadow on the lens. They say nothing of the scene, and outvote those that do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from edit3r.contract.reporting import warn
from edit3r_geometry.cameras import CalibratedImage

# The numbers of this block: docs/notes/ledger.md.
STILL = 0.6  # way up to which a match stands still [pixels of 512]
MOVED = 4.0  # way beyond which it surely moves
FEWEST = 8  # matches that make something that stands still
FEWEST_MOVED = 20
AROUND = 4  # pixels on each side of a place
GAP = 0.5  # matches between still and moved, for each still one, beyond which there is no gap

Places = Float[np.ndarray, "match 2"]
Pairs = Mapping[tuple[int, int], Int[np.ndarray, "match 2"]]


@dataclass(frozen=True)
class Keypoints:
    """Where the features are and what they look like."""

    # x, y [pixels of the image, pixel centres at +0.5], float64
    points: Float[np.ndarray, "point 2"]
    descriptors: Float[np.ndarray, "point 128"]  # unit length, float32

    def __len__(self) -> int:
        return len(self.points)

    def followed_by(self, more: "Keypoints") -> "Keypoints":
        """These features, then `more` of the same image."""
        return Keypoints(
            *map(
                np.concatenate,
                ((self.points, more.points), (self.descriptors, more.descriptors)),
            )
        )


def without_standing(
    keypoints: Sequence[Keypoints], pairs: Pairs, images: Sequence[CalibratedImage]
) -> dict[tuple[int, int], Int[np.ndarray, "match 2"]]:
    """The matches of each pair without those that stand still where all others move.

    What is far away hardly moves either, but then other points move a little: between what stands
    still and what moves there is no gap.
    """
    kept, said = {}, 0
    for (a, b), indices in pairs.items():
        if images[a].size == images[b].size:
            points = (
                keypoints[a].points[indices[:, 0]],
                keypoints[b].points[indices[:, 1]],
            )
            still = _still(*points, images[a], images[b])
            said += int(still.sum())
            indices = indices[~still]
        kept[a, b] = indices
    if said:
        warn(
            f"{said} matches stand at the same places of the photos while others move, as those of "
            "a screen, a frame or a watermark do; they are left out. Crop such parts away for a "
            "better scene."
        )
    return kept


def _still(
    first: Places, second: Places, one: CalibratedImage, other: CalibratedImage
) -> Bool[np.ndarray, "match"]:
    """Which matches stand still, if that is because of a screen."""
    way = np.linalg.norm(first - second, axis=1) * (512 / max(one.size))
    still = way < STILL
    moved = int((way > MOVED).sum())
    between = len(way) - moved - int(still.sum())
    if still.sum() < FEWEST or moved < FEWEST_MOVED or between > GAP * still.sum():
        return np.zeros_like(still)
    # Where most stand still, it may be the camera that does, and what moves is a thing: then their
    # pixels are alike and not the same.
    is_screen = still.sum() <= moved or _same_pixels(first[still], one, other) > 0.5
    return still & bool(is_screen)


def _same_pixels(places: Places, one: CalibratedImage, other: CalibratedImage) -> float:
    """Share of the places around which two images are the very same."""
    apart = np.abs(one.pixels - other.pixels).max(-1)
    around = cv2.dilate(apart, np.ones((2 * AROUND + 1,) * 2, np.uint8))
    height, width = one.size
    columns, rows = np.rint(places).astype(int).T
    values = around[rows.clip(0, height - 1), columns.clip(0, width - 1)]
    return float((values < 1 / 255).mean())
