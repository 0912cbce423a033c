"""Which of many photos, and which frames of a video, to use: few that together show what all show.

Both are files; frames, and pictures from memory, only inside a block of `temporary_photos`.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say, track, warn
from edit3r.kit.files.atomic import scratch_folder
from edit3r.kit.photos.decode import MAX_PIXELS, read_image
from edit3r.kit.photos.overlap import (
    SIDE,
    ImageFeatures,
    covering,
    features_of,
    motion,
    shared,
)

# The numbers of this block: no figures kept.
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".webm", ".mkv", ".avi")
USUAL_FRAMES = 8  # of a video, where no number is asked for
MAX_COMPARED = 90  # frames of a video
# A longer video is taken for a damaged one: an hour has 108,000 at 30 a second.
MAX_FRAMES = 200_000
SECONDS = 4  # of a core, that a frame's part of a scene usually takes
MIN_MOTION = 0.01  # median, between frames that are kept [image widths]


class TakenPhotos:
    """Photos that are files for a while: frames of videos, pictures from memory."""

    def __init__(self) -> None:
        self.folders = ExitStack()  # closed, it removes them
        self.origins: dict[Path, str] = {}  # what each is of, as people know it

    def new_folder(self, name: str) -> Path:
        """A new folder that lasts as long as these photos do."""
        return self.folders.enter_context(scratch_folder(name))


_taken: ContextVar[TakenPhotos | None] = ContextVar("edit3r_photos", default=None)


def taken_photos() -> TakenPhotos:
    """Those of the block of `temporary_photos` around the call; there must be one."""
    taken = _taken.get()
    if taken is None:
        raise RuntimeError(
            "frames of a video and pictures in memory become files inside a block of "
            "edit3r.kit.photos.coverage.temporary_photos() only, and none is around this call."
        )
    return taken


@contextmanager
def temporary_photos() -> Iterator[None]:
    """Remove photos that are made inside the block when it ends; of nested ones, the outer one."""
    if _taken.get() is not None:
        yield
        return
    taken = TakenPhotos()
    token = _taken.set(taken)
    try:
        with taken.folders:
            yield
    finally:
        _taken.reset(token)


def origin(file: Path) -> str:
    """The file as people know it: for a frame of a video, the video and the frame's number."""
    taken = _taken.get()
    return str(file) if taken is None else taken.origins.get(file, str(file))


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
