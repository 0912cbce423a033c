"""Camera files: our `cameras.json`, and nerfstudio's `transforms.json` (read only).

`cameras.json` is a list of `{file, width, height, K, c2w}`: `file` relative to the list's folder, `K` 3x3 in pixels of
the upright image with the centre of its top-left pixel at (0.5, 0.5), `c2w` 4x4 camera to world with OpenCV axes
(x right, y down, z forward). `K` and `c2w` may be null.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from edit3r.errors import InputError
from edit3r.geometry.cameras import to_pixels
from edit3r.io.atomic import atomic_write
from edit3r.io.decode import image_size
from edit3r.types import Cameras

__all__ = ["CAMERA_FILES", "PosedCamera", "posed_cameras", "read_cameras", "write_cameras"]

CAMERA_FILES = ("cameras.json", "transforms.json")
"""Names looked for beside photos, in this order."""

_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_PINHOLE_MODELS = (None, "PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order


@dataclass(frozen=True)
class PosedCamera:
    """What a camera file says of one image."""

    file: str  # as written, relative to the camera file's folder
    width: int  # [pixels]
    height: int  # [pixels]
    K: Float64[np.ndarray, "3 3"] | None  # [pixels], centre of the top-left pixel at (0.5, 0.5); None: not known
    c2w: Float64[np.ndarray, "4 4"] | None  # OpenCV axes, the file's own scale; None: not known
    distortion: tuple[float, ...] = ()  # OpenCV's k1, k2, p1, p2, k3; () for a plain pinhole

    @property
    def intrinsics(self) -> Float64[np.ndarray, "3 3"] | None:
        """`K` normalised as everywhere inside edit3r: fx, cx in widths, fy, cy in heights."""
        return None if self.K is None else self.K / np.array([[self.width], [self.height], [1.0]])


def read_cameras(path: str | Path) -> list[PosedCamera]:
    """Read a `cameras.json` or `transforms.json`, told apart by content. Raises InputError naming what is wrong."""
    path = Path(path)
    content = _read_json(path)
    if isinstance(content, list):
        entries, parse = content, _from_list_entry
    elif isinstance(content, dict) and isinstance(content.get("frames"), list):
        entries, parse = [{**content, **f} if isinstance(f, dict) else f for f in content["frames"]], _from_frame
    else:
        raise InputError(f"{path}: expected a list of cameras, or nerfstudio's layout with 'frames'.")
    cameras = []
    for index, entry in enumerate(entries):
        try:
            cameras.append(_checked(parse(entry, path.parent)))
        except InputError:
            raise
        except KeyError as error:
            raise InputError(f"{path}: camera {index} lacks {error.args[0]!r}.") from None
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(f"{path}: camera {index} cannot be used ({error}).") from None
    return cameras


def read_scene_cameras(path: str | Path) -> tuple[Cameras, list[PosedCamera]]:
    """The cameras of a file that have a pose and intrinsics, as one scene at the first one's image size."""
    if not Path(path).is_file():
        raise InputError(f"{path}: no such camera file; say where to look from with --cameras FILE.")
    posed = [camera for camera in read_cameras(path) if camera.c2w is not None and camera.K is not None]
    if not posed:
        raise InputError(f"{path}: no camera in it has both intrinsics and a pose.")
    c2w, intrinsics = (
        torch.from_numpy(np.stack(matrices)).float()[None]
        for matrices in ([camera.c2w for camera in posed], [camera.intrinsics for camera in posed])
    )
    return Cameras(c2w, intrinsics, (posed[0].height, posed[0].width)), posed


def posed_cameras(cameras: Cameras, files: Sequence[str]) -> list[PosedCamera]:
    """Cameras of one scene (batch 1) as file entries."""
    if cameras.c2w.shape[0] != 1 or cameras.count != len(files):
        raise ValueError(f"expected one scene with {len(files)} cameras, got {tuple(cameras.c2w.shape[:2])}")
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0].double(), cameras.image_size).cpu().numpy()
    poses = cameras.c2w[0].double().cpu().numpy()
    return [PosedCamera(file, width, height, k, c2w) for file, k, c2w in zip(files, pixels, poses)]


def write_cameras(path: str | Path, cameras: Sequence[PosedCamera]) -> None:
    """Write `cameras.json`, one camera a line, numbers to 9 significant digits (float32 survives exactly)."""
    lines = [json.dumps(_to_entry(camera), allow_nan=False) for camera in cameras]
    with atomic_write(path) as partial:
        partial.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


def _to_entry(camera: PosedCamera) -> dict[str, Any]:
    entry = {"file": camera.file, "width": camera.width, "height": camera.height}
    for name, matrix in (("K", camera.K), ("c2w", camera.c2w)):
        entry[name] = None if matrix is None else [[float(f"{x:.9g}") for x in row] for row in np.asarray(matrix)]
    return entry


def _read_json(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such camera file.")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}).") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from None


def _from_list_entry(entry: Mapping[str, Any], folder: Path) -> PosedCamera:
    return PosedCamera(
        str(entry["file"]),
        int(entry["width"]),
        int(entry["height"]),
        _matrix(entry.get("K"), (3, 3), "K"),
        _matrix(entry.get("c2w"), (4, 4), "c2w"),
    )


def _from_frame(frame: Mapping[str, Any], folder: Path) -> PosedCamera:
    if frame.get("camera_model") not in _PINHOLE_MODELS:
        raise ValueError(f"camera model {frame['camera_model']}, expected a pinhole; undistort the photos first")
    file, (height, width) = _image_of(frame, folder)
    focal_x = _focal(frame, "fl_x", "camera_angle_x", width)
    focal_y = _focal(frame, "fl_y", "camera_angle_y", height)
    pixels = None
    if focal_x or focal_y:
        centre_x, centre_y = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
        # One angle alone means square pixels.
        pixels = np.array([[focal_x or focal_y, 0, centre_x], [0, focal_y or focal_x, centre_y], [0, 0, 1.0]])
    pose = _matrix(frame.get("transform_matrix"), (4, 4), "transform_matrix")
    distortion = tuple(float(frame.get(name, 0.0)) for name in _DISTORTION)
    c2w = None if pose is None else pose @ _OPENGL_TO_OPENCV
    return PosedCamera(file, width, height, pixels, c2w, distortion if any(distortion) else ())


def _image_of(frame: Mapping[str, Any], folder: Path) -> tuple[str, tuple[int, int]]:
    """File as named on disk (Blender scenes leave the suffix out) and (height, width), from it if need be."""
    file = str(frame["file_path"])
    if not (folder / file).is_file() and (folder / f"{file}.png").is_file():
        file += ".png"
    if "w" in frame and "h" in frame:
        return file, (int(frame["h"]), int(frame["w"]))
    return file, image_size(folder / file)


def _focal(frame: Mapping[str, Any], focal: str, angle: str, size: int) -> float | None:
    if frame.get(focal) is not None:
        return float(frame[focal])
    if frame.get(angle) is not None:
        return 0.5 * size / math.tan(0.5 * float(frame[angle]))
    return None


def _matrix(value: Any, shape: tuple[int, int], name: str) -> Float64[np.ndarray, "rows columns"] | None:
    if value is None:
        return None
    matrix = np.array(value, dtype=np.float64)
    if name != "K" and matrix.shape == (3, 4):
        matrix = np.vstack((matrix, (0.0, 0.0, 0.0, 1.0)))
    if matrix.shape != shape:
        raise ValueError(f"{name} has shape {matrix.shape}, expected {shape}")
    return matrix


def _checked(camera: PosedCamera) -> PosedCamera:
    if camera.width < 1 or camera.height < 1:
        raise ValueError(f"size {camera.width}x{camera.height}, expected at least 1x1")
    for name, matrix in (("K", camera.K), ("c2w", camera.c2w)):
        if matrix is not None and not np.isfinite(matrix).all():
            raise ValueError(f"{name} holds values that are not finite")
    if camera.K is not None and min(camera.K[0, 0], camera.K[1, 1]) <= 0:
        raise ValueError(f"focal lengths {camera.K[0, 0]:g}, {camera.K[1, 1]:g}, expected above 0")
    return camera
