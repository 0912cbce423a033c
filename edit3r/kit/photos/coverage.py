"""Which of many photos, and which frames of a video, to use: few that together show what all show.

Two images share what their features (ORB, Rublee et al. 2011) have in common. Photos are chosen
greedily, each time the one that shows most of what those chosen so far do not (facility location;
Krause and Golovin 2014, section 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say, track, warn
from edit3r.kit.photos.decode import MAX_PIXELS, read_image
from edit3r.kit.photos.temporary import taken_photos

# The numbers of this block: no figures kept.
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".webm", ".mkv", ".avi")
USUAL_FRAMES = 8  # of a video, where no number is asked for
MAX_COMPARED = 90  # frames of a video
# A longer video is taken for a damaged one: an hour has 108,000 at 30 a second.
MAX_FRAMES = 200_000
SECONDS = 4  # of a core, that a frame's part of a scene usually takes
MIN_MOTION = 0.01  # median, between frames that are kept [image widths]
SIDE = 400  # longer side of the images that are compared [pixels]
FEATURES = 600  # of an image
MAX_HAMMING = 48  # bits of 256 in which the features of one point may differ
MIN_SHARED = 0.04  # share of features that two neighbours have in common


@dataclass(frozen=True)
class ImageFeatures:
    """What a small copy of an image shows."""

    points: Float[np.ndarray, "feature 2"]  # [image widths]
    descriptors: UInt8[np.ndarray, "feature 32"] | None
    sharpness: float  # variance of the Laplacian


@dataclass(frozen=True)
class VideoFrame:
    """One frame of a video."""

    number: int
    pixels: UInt8[np.ndarray, "height width 3"]  # BGR, as OpenCV writes it
    features: ImageFeatures


def choose_photos(files: Sequence[Path], most: int | None) -> list[Path]:
    """At most `most` of the photos, in their order, that cover what all show; all for None."""
    if most is None or len(files) <= most:
        return list(files)
    features = []
    for file in track(list(files), "compare photos"):
        features.append(features_of(np.asarray(read_image(file, 2 * SIDE))))
    return [files[index] for index in covering(shared(features), most)]


def take_frames(video: Path, most: int = USUAL_FRAMES) -> list[Path]:
    """The frames to use of a video, as image files of the block of `temporary_photos` around.

    The sharpest of each stretch, without those in which nothing has moved, and of these the ones
    that cover the scene. Raises InputError for a file that is no video, or has fewer than two
    frames that differ.
    """
    frames = _sharpest(video, 3 * most)
    moved = frames[:1]
    for frame in frames[1:]:
        if motion(moved[-1].features, frame.features) >= MIN_MOTION:
            moved.append(frame)
    if len(moved) < 2:
        raise InputError(
            f"{video}: shows the scene from one place only; move the camera sideways while filming."
        )
    if len(moved) < min(most, len(frames)):
        warn(
            f"{video}: {len(frames) - len(moved)} of {len(frames)} frames are left out, nothing "
            "has moved in them."
        )
    common = shared([frame.features for frame in moved])
    chosen = [moved[index] for index in covering(common, most)]
    numbers = ", ".join(str(frame.number) for frame in chosen)
    say(
        "video.frames",
        f"of {video.name} frames {numbers} are used; their scene usually takes a core about "
        f"{SECONDS * len(chosen)} s at 512 pixels, besides the edit",
    )
    return _write(chosen, video)


def _sharpest(video: Path, stretches: int) -> list[VideoFrame]:
    """The sharpest of the frames that are looked at, in each stretch of the video."""
    count = _frame_count(video)
    stretches = min(stretches, count)
    step = max(1, count // max(MAX_COMPARED, stretches))
    best: dict[int, VideoFrame] = {}
    capture = cv2.VideoCapture(str(video))
    for number in track(range(count), "read video"):
        if not capture.grab() or number % step:
            continue
        good, pixels = capture.retrieve()
        if not good:
            continue
        features = features_of(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB))
        stretch = number * stretches // count
        before = best.get(stretch)
        if before is None or features.sharpness > before.features.sharpness:
            best[stretch] = VideoFrame(number, pixels, features)
    capture.release()
    return [best[stretch] for stretch in sorted(best)]


def _frame_count(video: Path) -> int:
    """Number of frames that can be read; headers may lie, so they are counted."""
    capture = cv2.VideoCapture(str(video))
    width = capture.get(cv2.CAP_PROP_FRAME_WIDTH)
    height = capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if not capture.isOpened() or not 0 < width * height <= MAX_PIXELS:
        raise InputError(f"{video}: not a video that OpenCV can read.")
    count = 0
    while count < MAX_FRAMES and capture.grab():
        count += 1
    capture.release()
    if count == MAX_FRAMES:
        raise InputError(
            f"{video}: {MAX_FRAMES:,} frames or more, so it is damaged or too long; cut out the "
            "part that shows the scene."
        )
    if count < 2:
        raise InputError(f"{video}: a video of {count} frames; expected two at least.")
    return count


def _write(frames: Sequence[VideoFrame], video: Path) -> list[Path]:
    """Write frames as PNG into a new folder."""
    taken = taken_photos()
    folder = taken.new_folder("edit3r-video")
    files = []
    for frame in frames:
        name = f"{video.stem}_{frame.number:05d}.png"
        file = folder / name
        if not cv2.imwrite(str(file), frame.pixels):
            raise InputError(f"{video}: a frame of it could not be written to {file}.")
        taken.origins[file] = f"{video}, frame {frame.number}"
        files.append(file)
    return files


def features_of(pixels: UInt8[np.ndarray, "height width 3"]) -> ImageFeatures:
    """Features and sharpness of an RGB image, measured on a copy of `SIDE` pixels."""
    scale = SIDE / max(pixels.shape[:2])
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    orb = cv2.ORB.create(FEATURES, fastThreshold=7)
    keypoints, descriptors = orb.detectAndCompute(grey, None)  # None: no mask
    points = cv2.KeyPoint.convert(keypoints)
    points = np.reshape(points, (-1, 2)).astype(np.float64) / grey.shape[1]
    return ImageFeatures(points, descriptors, cv2.Laplacian(grey, cv2.CV_64F).var())


def motion(first: ImageFeatures, second: ImageFeatures) -> float:
    """Median displacement of what both show [image widths]; infinite where they share little."""
    pairs = _matches(first, second)
    if len(pairs) < max(1, MIN_SHARED * len(first.points)):
        return float("inf")
    moved = first.points[pairs[:, 0]] - second.points[pairs[:, 1]]
    return float(np.median(np.linalg.norm(moved, axis=1)))


def shared(images: Sequence[ImageFeatures]) -> Float[np.ndarray, "photo photo"]:
    """For each pair the share of features that both show, in [0, 1]; 1 on the diagonal."""
    result = np.eye(len(images))
    for i, first in enumerate(images):
        for j, second in enumerate(images[:i]):
            fewer = max(1, min(len(first.points), len(second.points)))
            result[i, j] = result[j, i] = len(_matches(first, second)) / fewer
    return result


def covering(common: Float[np.ndarray, "photo photo"], most: int) -> list[int]:
    """Indices, in order, of at most `most` photos that show most of what all show.

    Each is linked to another of them where that is possible.
    """
    chosen: list[int] = []
    best = np.zeros(len(common))  # how much of each photo those chosen show
    while len(chosen) < min(most, len(common)):
        gains = np.maximum(common - best[:, None], 0).sum(0)
        free = np.ones(len(common), bool)
        free[chosen] = False
        linked = free & (best >= MIN_SHARED)
        eligible = linked if linked.any() else free
        chosen.append(int(np.argmax(np.where(eligible, gains, -1))))
        best = np.maximum(best, common[:, chosen[-1]])
    return sorted(chosen)


def _matches(first: ImageFeatures, second: ImageFeatures) -> np.ndarray:
    """Index pairs of features that are each other's nearest and alike."""
    pairs = []
    if first.descriptors is not None and second.descriptors is not None:
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        for match in matcher.match(first.descriptors, second.descriptors):
            if match.distance < MAX_HAMMING:
                pairs.append((match.queryIdx, match.trainIdx))
    return np.array(pairs, dtype=int).reshape(-1, 2)
