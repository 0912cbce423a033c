"""Which of many photos, and which frames of a video, to use: few that together show what all show.

Two pictures share what their features (ORB, Rublee et al. 2011) have in common. Photos are chosen
greedily, each time the one that shows most of what those chosen so far do not (facility location;
Krause and Golovin 2014, section 1).
"""

import atexit
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from edit3r.errors import InputError
from edit3r.io.decode import MAX_PIXELS, read_image
from edit3r.reporting import track, warn

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".webm", ".mkv", ".avi")
USUAL_FRAMES = 8  # of a video, where no number is asked for
MOST_LOOKED_AT = 90  # frames of a video
# a longer video is taken for a damaged one: an hour has 108,000 at 30 a second
MOST_FRAMES = 200_000
SIDE = 400  # longer side of the pictures that are compared [pixels]
FEATURES, ALIKE = (
    600,
    48,
)  # features of a picture; bits of 256 in which those of one point may differ
LINKED = 0.04  # least share of features that two neighbours have in common
LEAST_MOTION = 0.01  # of features between frames that are kept [picture widths]

frame_origins: dict[Path, str] = {}
"""For each frame that was taken from a video: the video and the frame's number."""


_frame_folders: list[Path] = []
"""Where frames of videos lie."""


@contextmanager
def frames_kept_for() -> Iterator[None]:
    """Remove frames taken from videos inside the block when it ends, not when the process does."""
    before = len(_frame_folders)
    try:
        yield
    finally:
        while len(_frame_folders) > before:
            shutil.rmtree(_frame_folders.pop(), ignore_errors=True)


def origin(file: Path) -> str:
    """The file as people know it: for a frame of a video, the video and the frame's number."""
    return frame_origins.get(file, str(file))


@dataclass(frozen=True)
class Look:
    """What a small copy of a picture shows."""

    points: Float[np.ndarray, "feature 2"]  # [picture widths]
    descriptors: UInt8[np.ndarray, "feature 32"] | None
    sharpness: float  # variance of the Laplacian


def choose_photos(files: Sequence[Path], most: int | None) -> list[Path]:
    """At most `most` of the photos, in their order, that cover what all show; all of them for
    None.
    """
    if most is None or len(files) <= most:
        return list(files)
    looks = [
        look(np.asarray(read_image(file)))
        for file in track(list(files), "compare photos")
    ]
    return [files[index] for index in covering(shared(looks), most)]


def take_frames(video: Path, most: int = USUAL_FRAMES) -> list[Path]:
    """The frames to use of a video, as picture files that last as long as the process.

    The sharpest of each stretch, without those in which nothing has moved, and of these the ones
    that cover the scene. Raises InputError for a file that is no video, or has fewer than two
    frames that differ.
    """
    rows = _sharpest(video, 3 * most)
    moved = rows[:1]
    for row in rows[1:]:
        if motion(moved[-1][0], row[0]) >= LEAST_MOTION:
            moved.append(row)
    if len(moved) < 2:
        raise InputError(
            f"{video}: shows the scene from one place only; move the camera sideways while filming."
        )
    if len(moved) < min(most, len(rows)):
        warn(
            f"{video}: {len(rows) - len(moved)} of {len(rows)} frames are left out, nothing has "
            "moved in them."
        )
    folder = Path(tempfile.mkdtemp(prefix="edit3r-video-"))
    _frame_folders.append(folder)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    taken = []
    for _, frame, number in (
        moved[index] for index in covering(shared([row[0] for row in moved]), most)
    ):
        file = folder / f"{video.stem}_{number:05d}.png"
        if not cv2.imwrite(str(file), frame):
            raise InputError(
                f"{video}: a frame of it could not be written to {folder}."
            )
        frame_origins[file] = f"{video}, frame {number}"
        taken.append(file)
    return taken


def look(pixels: UInt8[np.ndarray, "height width 3"]) -> Look:
    """Features and sharpness of a picture, measured on a copy of `SIDE` pixels."""
    scale = SIDE / max(pixels.shape[:2])
    grey = cv2.cvtColor(
        cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA),
        cv2.COLOR_RGB2GRAY,
    )
    points, descriptors = cv2.ORB_create(FEATURES, fastThreshold=7).detectAndCompute(
        grey, None
    )  # None: no feature
    places = (
        np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2)
        / grey.shape[1]
    )
    return Look(places, descriptors, float(cv2.Laplacian(grey, cv2.CV_64F).var()))


def motion(first: Look, second: Look) -> float:
    """Median way of what both show [picture widths]; infinite where they share little."""
    pairs = _matches(first, second)
    if len(pairs) < LINKED * len(first.points) or not len(pairs):
        return float("inf")
    return float(
        np.median(
            np.linalg.norm(
                first.points[pairs[:, 0]] - second.points[pairs[:, 1]], axis=1
            )
        )
    )


def shared(looks: Sequence[Look]) -> Float[np.ndarray, "photo photo"]:
    """For each pair the share of features that both show, in [0, 1]; 1 on the diagonal."""
    result = np.eye(len(looks))
    for i in range(len(looks)):
        for j in range(i):
            fewer = max(1, min(len(looks[i].points), len(looks[j].points)))
            result[i, j] = result[j, i] = len(_matches(looks[i], looks[j])) / fewer
    return result


def covering(common: Float[np.ndarray, "photo photo"], most: int) -> list[int]:
    """Indices, in order, of at most `most` photos that show most of what all show, each linked to
    another of them.
    """
    chosen: list[int] = []
    best = np.zeros(len(common))
    while len(chosen) < min(most, len(common)):
        gains = np.maximum(common - best[:, None], 0).sum(0)
        linked = (
            (common[chosen].max(0) >= LINKED) if chosen else np.ones(len(common), bool)
        )
        free = ~np.isin(np.arange(len(common)), chosen)
        eligible = free & linked if (free & linked).any() else free
        chosen.append(int(np.argmax(np.where(eligible, gains, -1))))
        best = np.maximum(best, common[:, chosen[-1]])
    return sorted(chosen)


def _matches(first: Look, second: Look) -> np.ndarray:
    """Index pairs of features that are each other's nearest and alike."""
    if first.descriptors is None or second.descriptors is None:
        return np.zeros((0, 2), int)
    found = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
        first.descriptors, second.descriptors
    )
    pairs = [
        (match.queryIdx, match.trainIdx) for match in found if match.distance < ALIKE
    ]
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _sharpest(video: Path, stretches: int) -> list[tuple[Look, np.ndarray, int]]:
    """Look, pixels (BGR) and number of the sharpest frame of each stretch, of the frames that are
    looked at.
    """
    count = _frame_count(video)
    stretches = min(stretches, count)
    step = max(1, count // max(MOST_LOOKED_AT, stretches))
    best: dict[int, tuple[Look, np.ndarray, int]] = {}
    capture = cv2.VideoCapture(str(video))
    for number in track(range(count), "read video"):
        good, frame = (
            capture.retrieve()
            if capture.grab() and number % step == 0
            else (False, None)
        )
        if good:
            seen, stretch = (
                look(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)),
                number * stretches // count,
            )
            if stretch not in best or seen.sharpness > best[stretch][0].sharpness:
                best[stretch] = (seen, frame, number)
    capture.release()
    return [best[stretch] for stretch in sorted(best)]


def _frame_count(video: Path) -> int:
    """Number of frames that can be read; headers may lie, so they are counted."""
    capture = cv2.VideoCapture(str(video))
    size = capture.get(cv2.CAP_PROP_FRAME_WIDTH) * capture.get(
        cv2.CAP_PROP_FRAME_HEIGHT
    )
    if not capture.isOpened() or not 0 < size <= MAX_PIXELS:
        raise InputError(f"{video}: not a video that OpenCV can read.")
    count = 0
    while count < MOST_FRAMES and capture.grab():
        count += 1
    capture.release()
    if count < 2:
        raise InputError(f"{video}: a video of {count} frames; expected two at least.")
    return count
