"""Reads a folder of photos with known cameras: `cameras.json` or nerfstudio's `transforms.json`.

`cameras.json` is a list of `{file, width, height, K, c2w}`: K in pixels with the centre of the top-left pixel at
(0.5, 0.5), c2w with OpenCV axes. `transforms.json` has OpenGL axes (x right, y up, z back), `fl_x, fl_y, cx, cy, w, h`
at the top or per frame, and maybe distortion `k1, k2, p1, p2, k3`.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageOps

from edit3r.errors import InputError

__all__ = ["Photo", "PosedFolder", "PosedPhoto", "read_posed_folder"]

_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True)
class Photo:
    """One picture ready for evaluation: square, with the camera that took it."""

    image: np.ndarray  # [size, size, 3] sRGB in [0, 1], float32
    intrinsics: np.ndarray  # [3, 3] normalised
    c2w: np.ndarray  # [4, 4]


@dataclass(frozen=True)
class PosedPhoto:
    """One photo of a posed folder, not loaded yet."""

    path: Path
    intrinsics: np.ndarray  # [3, 3] normalised
    c2w: np.ndarray  # [4, 4], OpenCV axes, the scene's own scale
    distortion: tuple[float, ...] = ()  # OpenCV's k1, k2, p1, p2, k3; () for a plain pinhole

    def load(self, size: int) -> Photo:
        """The largest centred square of the photo, undistorted and resized to `size`."""
        image, intrinsics = _centre_square(self._pixels(), self.intrinsics)
        resized = image.resize((size, size), Image.Resampling.LANCZOS, reducing_gap=3.0)
        return Photo(np.asarray(resized, np.float32) / 255, intrinsics, self.c2w)

    def _pixels(self) -> Image.Image:
        try:
            with Image.open(self.path) as file:
                image = ImageOps.exif_transpose(file).convert("RGB")
        except OSError as error:
            raise InputError(f"{self.path}: not a picture that can be read ({error}).") from None
        if not any(self.distortion):
            return image
        pixels = self.intrinsics * np.array([[image.width], [image.height], [1.0]])
        pixels[:2, 2] -= 0.5  # OpenCV counts from pixel centres
        return Image.fromarray(cv2.undistort(np.asarray(image), pixels, np.array(self.distortion)))


@dataclass(frozen=True)
class PosedFolder:
    """A scene: photos in the order of its camera file; those without a pose are left out."""

    name: str
    path: Path
    photos: tuple[PosedPhoto, ...]


def read_posed_folder(path: str | Path) -> PosedFolder:
    """Read `cameras.json`, else `transforms.json`. Raises InputError naming the file and what it lacks."""
    path = Path(path)
    for name, parse in (("cameras.json", _parse_cameras), ("transforms.json", _parse_transforms)):
        file = path / name
        if file.is_file():
            try:
                photos = parse(json.loads(file.read_text(encoding="utf-8")), path)
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(f"{file}: not a camera file of the expected layout ({error!r}).") from None
            if not photos:
                raise InputError(f"{file}: no photo has both a pose (c2w) and intrinsics (K).")
            return PosedFolder(path.resolve().name, path, tuple(photos))
    raise InputError(f"{path}: expected a folder with a cameras.json or a transforms.json.")


def _parse_cameras(entries: list[Mapping], folder: Path) -> list[PosedPhoto]:
    return [
        PosedPhoto(
            folder / entry["file"],
            np.array(entry["K"], float) / np.array([[entry["width"]], [entry["height"]], [1.0]]),
            np.array(entry["c2w"], float).reshape(4, 4),
        )
        for entry in entries
        if entry["K"] is not None and entry["c2w"] is not None
    ]


def _parse_transforms(content: Mapping, folder: Path) -> list[PosedPhoto]:
    return [_parse_frame({**content, **frame}, folder) for frame in content["frames"]]


def _parse_frame(frame: Mapping, folder: Path) -> PosedPhoto:
    width, height = float(frame["w"]), float(frame["h"])
    focal_x = float(frame["fl_x"] if "fl_x" in frame else 0.5 * width / np.tan(0.5 * float(frame["camera_angle_x"])))
    focal_y = float(frame.get("fl_y", focal_x))
    centre_x, centre_y = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
    intrinsics = [[focal_x / width, 0, centre_x / width], [0, focal_y / height, centre_y / height], [0, 0, 1]]
    c2w = np.array(frame["transform_matrix"], float).reshape(4, 4) @ _OPENGL_TO_OPENCV
    distortion = tuple(float(frame.get(name, 0.0)) for name in _DISTORTION)
    return PosedPhoto(folder / frame["file_path"], np.array(intrinsics), c2w, distortion)


def _centre_square(image: Image.Image, intrinsics: np.ndarray) -> tuple[Image.Image, np.ndarray]:
    """Crop to the largest centred square; focal length and centre follow exactly."""
    side = min(image.size)
    left, top = (image.width - side) // 2, (image.height - side) // 2
    pixels = intrinsics * np.array([[image.width], [image.height], [1.0]])
    pixels[:2, 2] -= (left, top)
    return image.crop((left, top, left + side, top + side)), pixels / np.array([[side], [side], [1.0]])
