"""Camera files: our `cameras.json`, and nerfstudio's `transforms.json` (read only).

`cameras.json` is a list of `{file, width, height, K, c2w}`: `file` relative to the list's folder,
`K` 3x3 in pixels of the upright image with the centre of its top-left pixel at (0.5, 0.5), `c2w`
4x4 camera to world with OpenCV axes (x right, y down, z forward). `K` and `c2w` may be null.
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

from edit3r.contract.types import Cameras
from edit3r.errors import InputError
from edit3r.geometry.cameras import to_pixels
from edit3r.io.atomic import atomic_write
from edit3r.io.decode import MAX_PIXELS, image_size
from edit3r.io.framing import Lens

__all__ = [
    "CAMERA_FILES",
    "PosedCamera",
    "intrinsics_from_outside",
    "pose_from_outside",
    "posed_cameras",
    "read_cameras",
    "read_scene_cameras",
    "write_cameras",
]

CAMERA_FILES = ("cameras.json", "transforms.json")
"""Names looked for beside photos, in this order."""

TOLERANCE = 0.01
"""How far a rotation's products, or a number that must be 0 or 1, may be off: files are rounded."""

FOCAL = (0.01, 1000.0)  # of the longer side
FARTHEST = (
    1e8  # of a position [the file's unit]: float32 would keep nothing of the rest
)
FARTHEST_CENTRE = 100.0  # of the principal point [image widths, heights]

_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_PINHOLE_MODELS = (
    None,
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "OPENCV",
    "SIMPLE_RADIAL",
    "RADIAL",
)
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order


@dataclass(frozen=True)
class PosedCamera:
    """What a camera file says of one image."""

    file: str  # as written, relative to the camera file's folder
    width: int  # [pixels]
    height: int  # [pixels]
    K: (
        Float64[np.ndarray, "3 3"] | None
    )  # [pixels], centre of the top-left pixel at (0.5, 0.5); None: not known
    c2w: (
        Float64[np.ndarray, "4 4"] | None
    )  # OpenCV axes, the file's own scale; None: not known
    distortion: tuple[
        float, ...
    ] = ()  # OpenCV's k1, k2, p1, p2, k3; () for a plain pinhole

    @property
    def intrinsics(self) -> Float64[np.ndarray, "3 3"] | None:
        """`K` normalised as everywhere inside edit3r: fx, cx in widths, fy, cy in heights."""
        return (
            None
            if self.K is None
            else self.K / np.array([[self.width], [self.height], [1.0]])
        )

    @property
    def lens(self) -> Lens | None:
        """What bends straight lines in the photo; None for a plain pinhole."""
        if self.K is None or not self.distortion:
            return None
        (fx, _, cx), (_, fy, cy), _ = self.intrinsics.tolist()
        return Lens((fx, fy), (cx, cy), self.distortion)


def read_cameras(path: str | Path) -> list[PosedCamera]:
    """Read a `cameras.json` or `transforms.json`, told apart by content. Raises InputError naming
    what is wrong.
    """
    path = Path(path)
    content = _read_json(path)
    if isinstance(content, list):
        entries, parse = content, _from_list_entry
    elif isinstance(content, dict) and isinstance(content.get("frames"), list):
        entries, parse = (
            [{**content, **f} if isinstance(f, dict) else f for f in content["frames"]],
            _from_frame,
        )
    else:
        raise InputError(
            f"{path}: expected a list of cameras, or nerfstudio's layout with 'frames'."
        )
    cameras = []
    for index, entry in enumerate(entries):
        try:
            cameras.append(parse(entry, path.parent))
        except InputError:
            raise
        except KeyError as error:
            raise InputError(
                f"{path}: camera {index} lacks {error.args[0]!r}."
            ) from None
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"{path}: camera {index} cannot be used ({error})."
            ) from None
    return cameras


def read_scene_cameras(path: str | Path) -> tuple[Cameras, list[PosedCamera]]:
    """The cameras of a file that have a pose and intrinsics, as one scene at the first one's image
    size.
    """
    if not Path(path).is_file():
        raise InputError(
            f"{path}: no such camera file; say where to look from with --cameras FILE."
        )
    posed = [
        camera
        for camera in read_cameras(path)
        if camera.c2w is not None and camera.K is not None
    ]
    if not posed:
        raise InputError(f"{path}: no camera in it has both intrinsics and a pose.")
    c2w, intrinsics = (
        torch.from_numpy(np.stack(matrices)).float()[None]
        for matrices in (
            [camera.c2w for camera in posed],
            [camera.intrinsics for camera in posed],
        )
    )
    return Cameras(c2w, intrinsics, (posed[0].height, posed[0].width)), posed


def posed_cameras(cameras: Cameras, files: Sequence[str]) -> list[PosedCamera]:
    """Cameras of one scene (batch 1) as file entries."""
    if cameras.c2w.shape[0] != 1 or cameras.count != len(files):
        raise ValueError(
            f"expected one scene with {len(files)} cameras, got {tuple(cameras.c2w.shape[:2])}"
        )
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0].double(), cameras.image_size).cpu().numpy()
    poses = cameras.c2w[0].double().cpu().numpy()
    return [
        PosedCamera(file, width, height, k, c2w)
        for file, k, c2w in zip(files, pixels, poses)
    ]


def write_cameras(path: str | Path, cameras: Sequence[PosedCamera]) -> None:
    """Write `cameras.json`, one camera a line, numbers to 9 significant digits (float32 survives
    exactly).
    """
    lines = [json.dumps(_to_entry(camera), allow_nan=False) for camera in cameras]
    with atomic_write(path) as partial:
        partial.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


def _to_entry(camera: PosedCamera) -> dict[str, Any]:
    entry = {"file": camera.file, "width": camera.width, "height": camera.height}
    for name, matrix in (("K", camera.K), ("c2w", camera.c2w)):
        entry[name] = (
            None
            if matrix is None
            else [[float(f"{x:.9g}") for x in row] for row in np.asarray(matrix)]
        )
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
    file = _file_name(entry["file"])
    width, height = _size(entry["width"], entry["height"])
    return PosedCamera(
        file,
        width,
        height,
        intrinsics_from_outside(entry.get("K"), width, height),
        pose_from_outside(entry.get("c2w"), "c2w"),
    )


def _from_frame(frame: Mapping[str, Any], folder: Path) -> PosedCamera:
    if frame.get("camera_model") not in _PINHOLE_MODELS:
        raise ValueError(
            f"camera model {frame['camera_model']}, expected a pinhole; undistort the photos first"
        )
    file, (height, width) = _image_of(frame, folder)
    focal_x = _focal(frame, "fl_x", "camera_angle_x", width)
    focal_y = _focal(frame, "fl_y", "camera_angle_y", height)
    pixels = None
    if focal_x or focal_y:
        centre_x, centre_y = (
            float(frame.get("cx", width / 2)),
            float(frame.get("cy", height / 2)),
        )
        # One angle alone means square pixels.
        rows = [
            [focal_x or focal_y, 0, centre_x],
            [0, focal_y or focal_x, centre_y],
            [0, 0, 1.0],
        ]
        pixels = intrinsics_from_outside(rows, width, height)
    pose = pose_from_outside(frame.get("transform_matrix"), "transform_matrix")
    distortion = tuple(float(frame.get(name, 0.0)) for name in _DISTORTION)
    Lens((1.0, 1.0), (0.5, 0.5), distortion)  # raises where it is none
    c2w = None if pose is None else pose @ _OPENGL_TO_OPENCV
    return PosedCamera(
        file, width, height, pixels, c2w, distortion if any(distortion) else ()
    )


def _image_of(frame: Mapping[str, Any], folder: Path) -> tuple[str, tuple[int, int]]:
    """File as named on disk (Blender scenes leave the suffix out) and (height, width), from it if
    need be.
    """
    file = _file_name(frame["file_path"])
    if not (folder / file).is_file() and (folder / f"{file}.png").is_file():
        file += ".png"
    if "w" in frame and "h" in frame:
        return file, _size(frame["w"], frame["h"])[::-1]
    return file, image_size(folder / file)


def _focal(frame: Mapping[str, Any], focal: str, angle: str, size: int) -> float | None:
    if frame.get(focal) is not None:
        return float(frame[focal])
    if frame.get(angle) is not None:
        return 0.5 * size / math.tan(0.5 * float(frame[angle]))
    return None


def pose_from_outside(value: Any, name: str) -> Float64[np.ndarray, "4 4"] | None:
    """Turn what a file says into a pose, a rotation and a position; None stays None.

    3x4 is taken as well. Raises ValueError, saying what is wrong, for anything else, such as a
    matrix that mirrors, scales or flattens the world.
    """
    if value is None:
        return None
    matrix = _numbers(value, name)
    if matrix.shape == (3, 4):
        matrix = np.vstack((matrix, (0.0, 0.0, 0.0, 1.0)))
    if matrix.shape != (4, 4):
        raise ValueError(f"{name} has shape {matrix.shape}, expected (4, 4)")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > TOLERANCE:
        raise ValueError(
            f"the last row of {name} is {_shown(matrix[3])}, expected 0, 0, 0, 1"
        )
    rotation = matrix[:3, :3]
    if (
        np.abs(rotation).max() > 1e6
        or np.abs(rotation.T @ rotation - np.eye(3)).max() > TOLERANCE
    ):
        lengths = _shown(np.hypot.reduce(rotation))
        raise ValueError(
            f"the axes in {name} are no rotation (lengths {lengths}), expected length 1 at right "
            "angles"
        )
    if np.linalg.det(rotation) < 0:
        raise ValueError(
            f"{name} mirrors the world, expected a rotation (determinant 1, not -1)"
        )
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        raise ValueError(
            f"the position in {name} is {_shown(matrix[:3, 3])}, expected at most {FARTHEST:g}"
        )
    return matrix


def intrinsics_from_outside(
    value: Any, width: float, height: float
) -> Float64[np.ndarray, "3 3"] | None:
    """Turn what a file says into intrinsics of an image of that size, in the same unit; None stays
    None.

    Raises ValueError, saying what is wrong, for anything but `[[fx, 0, cx], [0, fy, cy], [0, 0,
    1]]`.
    """
    if value is None:
        return None
    matrix = _numbers(value, "K")
    if matrix.shape != (3, 3):
        raise ValueError(f"K has shape {matrix.shape}, expected (3, 3)")
    focal = matrix[[0, 1], [0, 1]]
    if focal.min() <= 0:
        raise ValueError(f"focal lengths {_shown(focal)}, expected above 0")
    if not np.all(
        (focal > FOCAL[0] * max(width, height))
        & (focal < FOCAL[1] * max(width, height))
    ):
        raise ValueError(
            f"focal lengths {_shown(focal)}, expected {FOCAL[0]:g} to {FOCAL[1]:g} times the "
            "image's longer side"
        )
    if np.abs(matrix[:2, 2] / (width, height)).max() > FARTHEST_CENTRE:
        raise ValueError(
            f"the principal point of K is {_shown(matrix[:2, 2])}, far outside of the image"
        )
    rest = (matrix[0, 1] / focal[0], matrix[1, 0] / focal[1], *(matrix[2] - (0, 0, 1)))
    if np.abs(rest).max() > TOLERANCE:
        raise ValueError("K has other numbers where a pinhole has 0, 0, 0, 0 and 1")
    return matrix


def _numbers(value: Any, name: str) -> Float64[np.ndarray, "*shape"]:
    matrix = np.array(value, dtype=np.float64)
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} holds values that are not finite")
    return matrix


def _size(width: Any, height: Any) -> tuple[int, int]:
    """(width, height) as a file states them; raises ValueError for what is no size of an image."""
    if (
        isinstance(width, str)
        or isinstance(height, str)
        or int(width) != width
        or int(height) != height
    ):
        raise ValueError("width and height must be whole numbers")
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise ValueError(
            f"size {width:g}x{height:g}, expected at least 1x1 and at most {MAX_PIXELS // 10**6} "
            "megapixels"
        )
    return int(width), int(height)


def _file_name(value: Any) -> str:
    """A path of an image as a file states it; raises ValueError for what names no file."""
    named = (
        isinstance(value, str)
        and "\0" not in value
        and Path(value).name not in ("", "..")
        and len(value) <= 4096
    )
    if not named:
        raise ValueError(f"{str(value)[:60]!r} is no name of a picture file")
    return value


def _shown(values: Float64[np.ndarray, "*shape"]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
