"""Camera files: our `cameras.json`, and nerfstudio's `transforms.json`.

`cameras.json` is a list of `{file, width, height, K, c2w}`: `file` relative to the list's folder,
`K` 3x3 in pixels of the upright image with the centre of its top-left pixel at (0.5, 0.5), `c2w`
4x4 camera to world with OpenCV axes (x right, y down, z forward). `K` and `c2w` may be null.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from edit3r.contract.errors import InputError
from edit3r.contract.lens import Lens
from edit3r.contract.types import Cameras
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.geometry.cameras import to_pixels
from edit3r.kit.photos.decode import MAX_PIXELS, image_size

__all__ = [
    "CAMERA_FILES",
    "PosedCamera",
    "intrinsics_from_outside",
    "pose_from_outside",
    "posed_cameras",
    "read_cameras",
    "read_scene_cameras",
    "write_cameras",
    "write_transforms",
]

CAMERA_FILES = ("cameras.json", "transforms.json")
"""Names looked for beside photos, in this order."""

TOLERANCE = 0.01
"""How far a rotation's products, or a number that must be 0 or 1, may be off: files are rounded."""

MIN_FOCAL = 0.01  # of the longer side
MAX_FOCAL = 1000.0
MAX_POSITION = 1e8  # [the file's unit]: float32 would keep nothing of the rest
MAX_CENTRE = 100.0  # of the principal point [image widths, heights]

_OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order

Matrix3 = Float64[np.ndarray, "3 3"]
Matrix4 = Float64[np.ndarray, "4 4"]


@dataclass(frozen=True)
class PosedCamera:
    """What a camera file says of one image."""

    file: str  # as written, relative to the camera file's folder
    width: int  # [pixels]
    height: int  # [pixels]
    # [pixels], centre of the top-left pixel at (0.5, 0.5); None: not known
    K: Matrix3 | None
    c2w: Matrix4 | None  # OpenCV axes, the file's own scale; None: not known
    # OpenCV's k1, k2, p1, p2, k3; () for a plain pinhole
    distortion: tuple[float, ...] = ()

    @property
    def intrinsics(self) -> Matrix3 | None:
        """`K` normalised as everywhere inside edit3r: fx, cx in widths, fy, cy in heights."""
        if self.K is None:
            return None
        return self.K / np.array([[self.width], [self.height], [1.0]])

    @property
    def lens(self) -> Lens | None:
        """What bends straight lines in the photo; None for a plain pinhole."""
        if self.intrinsics is None or not self.distortion:
            return None
        (fx, _, cx), (_, fy, cy), _ = self.intrinsics.tolist()
        return Lens((fx, fy), (cx, cy), self.distortion)


def read_cameras(path: str | Path) -> list[PosedCamera]:
    """Read a `cameras.json` or `transforms.json`, told apart by content.

    Raises InputError naming what is wrong.
    """
    path = Path(path)
    content = _read_json(path)
    parse: Callable[[Any, Path], PosedCamera] = _from_list_entry
    if isinstance(content, dict) and isinstance(content.get("frames"), list):
        parse = _from_frame
        # What is said at the top holds for every frame.
        frames = content["frames"]
        content = [{**content, **f} if isinstance(f, dict) else f for f in frames]
    if not isinstance(content, list):
        raise InputError(
            f"{path}: expected a list of cameras, or nerfstudio's layout with 'frames'."
        )
    cameras = []
    for index, entry in enumerate(content):
        try:
            cameras.append(parse(entry, path.parent))
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
    """The cameras of a file that have a pose and intrinsics, at the first one's image size."""
    if not Path(path).is_file():
        raise InputError(
            f"{path}: no such camera file; say where to look from with --cameras FILE."
        )
    posed, poses, intrinsics = [], [], []
    for camera in read_cameras(path):
        if camera.c2w is not None and camera.intrinsics is not None:
            posed.append(camera)
            poses.append(torch.from_numpy(camera.c2w).float())
            intrinsics.append(torch.from_numpy(camera.intrinsics).float())
    if not posed:
        raise InputError(f"{path}: no camera in it has both intrinsics and a pose.")
    size = (posed[0].height, posed[0].width)
    return Cameras(torch.stack(poses)[None], torch.stack(intrinsics)[None], size), posed


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
    lines = []
    for camera in cameras:
        entry = {"file": camera.file, "width": camera.width, "height": camera.height}
        entry |= {"K": _rounded(camera.K), "c2w": _rounded(camera.c2w)}
        lines.append(json.dumps(entry, allow_nan=False))
    with atomic_write(path) as partial:
        partial.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


def write_transforms(path: str | Path, cameras: Cameras, files: Sequence[str]) -> None:
    """Write the cameras of one scene (batch 1) as nerfstudio's `transforms.json`."""
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0].double(), cameras.image_size).tolist()
    poses = (cameras.c2w[0].double() @ torch.from_numpy(_OPENGL_TO_OPENCV)).tolist()
    frames = []
    for file, ((fx, _, cx), (_, fy, cy), _), pose in zip(files, pixels, poses):
        frame = {"file_path": file, "w": width, "h": height}
        frame |= {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "transform_matrix": pose}
        frames.append(frame)
    content = {"camera_model": "PINHOLE", "frames": frames}
    with atomic_write(path) as partial:
        partial.write_text(json.dumps(content, indent=1, allow_nan=False), "utf-8")


def _rounded(matrix: np.ndarray | None) -> list[list[float]] | None:
    if matrix is None:
        return None
    return [[float(f"{number:.9g}") for number in row] for row in matrix]


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
    k = intrinsics_from_outside(entry.get("K"), width, height)
    return PosedCamera(
        file, width, height, k, pose_from_outside(entry.get("c2w"), "c2w")
    )


def _from_frame(frame: Mapping[str, Any], folder: Path) -> PosedCamera:
    model = frame.get("camera_model") or "PINHOLE"
    _require(
        model in _PINHOLES,
        f"camera model {model}, expected a pinhole; undistort the photos first",
    )
    file = _file_name(frame["file_path"])
    if not (folder / file).is_file() and (folder / f"{file}.png").is_file():
        file += ".png"  # Blender scenes leave the suffix out
    if "w" in frame and "h" in frame:
        width, height = _size(frame["w"], frame["h"])
    else:
        height, width = image_size(folder / file)
    pose = pose_from_outside(frame.get("transform_matrix"), "transform_matrix")
    distortion = tuple(float(frame.get(name, 0.0)) for name in _DISTORTION)
    Lens((1.0, 1.0), (0.5, 0.5), distortion)  # raises where it is none
    return PosedCamera(
        file,
        width,
        height,
        K=_frame_intrinsics(frame, width, height),
        c2w=None if pose is None else pose @ _OPENGL_TO_OPENCV,
        distortion=distortion if any(distortion) else (),
    )


def _frame_intrinsics(
    frame: Mapping[str, Any], width: int, height: int
) -> Matrix3 | None:
    x = _focal(frame, "fl_x", "camera_angle_x", width)
    y = _focal(frame, "fl_y", "camera_angle_y", height)
    if not x and not y:
        return None
    # One angle alone means square pixels.
    rows = [
        [x or y, 0, float(frame.get("cx", width / 2))],
        [0, y or x, float(frame.get("cy", height / 2))],
        [0, 0, 1.0],
    ]
    return intrinsics_from_outside(rows, width, height)


def _focal(frame: Mapping[str, Any], focal: str, angle: str, size: int) -> float | None:
    if frame.get(focal) is not None:
        return float(frame[focal])
    if frame.get(angle) is not None:
        return 0.5 * size / math.tan(0.5 * float(frame[angle]))
    return None


def pose_from_outside(value: Any, name: str) -> Matrix4 | None:
    """Turn what a file says into a pose, a rotation and a position; None stays None.

    3x4 is taken as well. Raises ValueError, saying what is wrong, for anything else, such as a
    matrix that mirrors, scales or flattens the world.
    """
    if value is None:
        return None
    matrix = _numbers(value, name)
    if matrix.shape == (3, 4):
        matrix = np.vstack((matrix, (0.0, 0.0, 0.0, 1.0)))
    _require(
        matrix.shape == (4, 4), f"{name} has shape {matrix.shape}, expected (4, 4)"
    )
    _require(
        _near(matrix[3], (0, 0, 0, 1)),
        f"the last row of {name} is {_shown(matrix[3])}, expected 0, 0, 0, 1",
    )
    rotation = matrix[:3, :3]
    lengths = np.hypot.reduce(rotation)
    _require(
        lengths.max() < 2 and _near(rotation.T @ rotation, np.eye(3)),
        f"the axes in {name} are no rotation (lengths {_shown(lengths)}), expected length 1 at "
        "right angles",
    )
    _require(
        np.linalg.det(rotation) > 0,
        f"{name} mirrors the world, expected a rotation (determinant 1, not -1)",
    )
    position = matrix[:3, 3]
    _require(
        np.abs(position).max() <= MAX_POSITION,
        f"the position in {name} is {_shown(position)}, expected at most {MAX_POSITION:g}",
    )
    return matrix


def intrinsics_from_outside(value: Any, width: float, height: float) -> Matrix3 | None:
    """Turn what a file says into intrinsics of an image of that size, in the same unit.

    None stays None. Raises ValueError, saying what is wrong, for anything but `[[fx, 0, cx], [0,
    fy, cy], [0, 0, 1]]`.
    """
    if value is None:
        return None
    matrix = _numbers(value, "K")
    _require(matrix.shape == (3, 3), f"K has shape {matrix.shape}, expected (3, 3)")
    focal = matrix.diagonal()[:2]
    shares = focal / max(width, height)
    _require(focal.min() > 0, f"focal lengths {_shown(focal)}, expected above 0")
    _require(
        shares.min() > MIN_FOCAL and shares.max() < MAX_FOCAL,
        f"focal lengths {_shown(focal)}, expected {MIN_FOCAL:g} to {MAX_FOCAL:g} times the "
        "image's longer side",
    )
    centre = matrix[:2, 2]
    _require(
        np.abs(centre / (width, height)).max() <= MAX_CENTRE,
        f"the principal point of K is {_shown(centre)}, far outside of the image",
    )
    skew = (matrix[0, 1] / focal[0], matrix[1, 0] / focal[1])
    _require(
        _near(skew, 0) and _near(matrix[2], (0, 0, 1)),
        "K has other numbers where a pinhole has 0, 0, 0, 0 and 1",
    )
    return matrix


def _require(holds: Any, problem: str) -> None:
    if not holds:
        raise ValueError(problem)


def _near(values: Any, expected: Any) -> bool:
    return bool(np.abs(np.subtract(values, expected)).max() <= TOLERANCE)


def _numbers(value: Any, name: str) -> Float64[np.ndarray, "*shape"]:
    matrix = np.array(value, dtype=np.float64)
    _require(np.isfinite(matrix).all(), f"{name} holds values that are not finite")
    return matrix


def _size(width: Any, height: Any) -> tuple[int, int]:
    """(width, height) as a file states them; raises ValueError for what is no size of an image."""
    for side in (width, height):
        _require(
            not isinstance(side, str) and int(side) == side,
            "width and height must be whole numbers",
        )
    _require(
        min(width, height) >= 1 and width * height <= MAX_PIXELS,
        f"size {width:g}x{height:g}, expected at least 1x1 and at most {MAX_PIXELS // 10**6} "
        "megapixels",
    )
    return int(width), int(height)


def _file_name(value: Any) -> str:
    """A path of an image as a file states it; raises ValueError for what names no file."""
    names_a_file = (
        isinstance(value, str)
        and "\0" not in value
        and Path(value).name not in ("", "..")
        and len(value) <= 4096
    )
    _require(names_a_file, f"{str(value)[:60]!r} is no name of an image file")
    return value


def _shown(values: Float64[np.ndarray, "*shape"]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
