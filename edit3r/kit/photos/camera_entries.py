"""What other programs' camera files say, image by image.

Read are our `cameras.json`, that of 3D Gaussian Splatting, nerfstudio's, instant-ngp's and
Blender's `transforms.json`, and COLMAP's models. An entry is checked when its camera is asked for:
a fault in it concerns nobody else. All that is stated is checked: sizes, intrinsics, poses, names.
"""

import math
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from edit3r.contract.errors import InputError
from edit3r.contract.lens import Lens
from edit3r.kit.files.text import HALF, parse_json
from edit3r.kit.photos.decode import MAX_JPEG_PIXELS, SUFFIXES, image_size

TOLERANCE = 0.01
"""How far a rotation's products, or a number that must be 0 or 1, may be off: files are rounded.
A sanity limit.
"""

# The numbers of this block: sanity limits.
MIN_FOCAL = 0.01  # of the longer side
MAX_FOCAL = 1000.0
MAX_POSITION = 1e8  # [the file's unit]: float32 would keep nothing of the rest
MAX_CENTRE = 100.0  # of the principal point [image widths, heights]

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
    mask: str = ""  # file of a mask of the image, relative to the camera file's folder

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

    def says_the_same_as(self, other: "PosedCamera") -> bool:
        """Whether both have the same lens and pose."""
        numbers: tuple[tuple[Any, Any], ...] = (
            ((self.width, self.height), (other.width, other.height)),
            (self.K, other.K),
            (self.c2w, other.c2w),
            (self.distortion, other.distortion),
        )
        return all(
            (a is None) == (b is None) and (a is None or np.array_equal(a, b))
            for a, b in numbers
        )


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
    require(matrix.shape == (4, 4), f"{name} has shape {matrix.shape}, expected (4, 4)")
    require(
        _near(matrix[3], (0, 0, 0, 1)),
        f"the last row of {name} is {_shown(matrix[3])}, expected 0, 0, 0, 1",
    )
    rotation = matrix[:3, :3]
    lengths = np.hypot.reduce(rotation)
    require(
        lengths.max() < 2 and _near(rotation.T @ rotation, np.eye(3)),
        f"the axes in {name} are no rotation (lengths {_shown(lengths)}), expected length 1 at "
        "right angles",
    )
    require(
        np.linalg.det(rotation) > 0,
        f"{name} mirrors the world, expected a rotation (determinant 1, not -1)",
    )
    position = matrix[:3, 3]
    require(
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
    require(matrix.shape == (3, 3), f"K has shape {matrix.shape}, expected (3, 3)")
    focal = matrix.diagonal()[:2]
    shares = focal / max(width, height)
    require(focal.min() > 0, f"focal lengths {_shown(focal)}, expected above 0")
    require(
        shares.min() > MIN_FOCAL and shares.max() < MAX_FOCAL,
        f"focal lengths {_shown(focal)}, expected {MIN_FOCAL:g} to {MAX_FOCAL:g} times the "
        "image's longer side",
    )
    centre = matrix[:2, 2]
    require(
        np.abs(centre / (width, height)).max() <= MAX_CENTRE,
        f"the principal point of K is {_shown(centre)}, far outside of the image",
    )
    skew = (matrix[0, 1] / focal[0], matrix[1, 0] / focal[1])
    require(
        _near(skew, 0) and _near(matrix[2], (0, 0, 1)),
        "K has other numbers where a pinhole has 0, 0, 0, 0 and 1",
    )
    return matrix


def require(holds: Any, problem: str) -> None:
    if not holds:
        raise ValueError(problem)


def _near(values: Any, expected: Any) -> bool:
    return bool(np.abs(np.subtract(values, expected)).max() <= TOLERANCE)


def _numbers(value: Any, name: str) -> Float64[np.ndarray, "*shape"]:
    matrix = np.array(value, dtype=np.float64)
    require(np.isfinite(matrix).all(), f"{name} holds values that are not finite")
    return matrix


def size_from_outside(width: Any, height: Any) -> tuple[int, int]:
    """(width, height) as a file states them; raises ValueError for what is no size of an image."""
    for side in (width, height):
        require(
            not isinstance(side, str | bool) and int(side) == side,
            "width and height must be whole numbers",
        )
    require(
        min(width, height) >= 1 and width * height <= MAX_JPEG_PIXELS,
        f"size {width:g}x{height:g}, expected at least 1x1 and at most {MAX_JPEG_PIXELS // 10**6} "
        "megapixels",
    )
    return int(width), int(height)


def file_name(value: Any) -> str:
    """A path of an image as a file states it; raises ValueError for what names no file.

    Bytes that are no UTF-8 stand for themselves, other halves of a character for nothing (`HALF`).
    """
    names_a_file = (
        isinstance(value, str)
        and "\0" not in value
        and not HALF.search(value)
        and Path(value).name not in ("", "..")
        and len(value) <= 4096
    )
    require(names_a_file, f"{str(value)[:60]!r} is no name of an image file")
    return value


def _shown(values: Float64[np.ndarray, "*shape"]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


# Entries

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# of a camera file: 100,000 cameras; as objects they take 20 times as much
MOST_BYTES = 1 << 26
_PINHOLES = (
    *("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE"),
    *("OPENCV", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV"),
)
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order
_RATIONAL = ("k4", "k5", "k6")  # OpenCV's next: only FULL_OPENCV means these by them
_OTHER_LENSES = ("is_fisheye", "ftheta_p0", "latlong", "equirectangular")

MODEL_PARTS = ("cameras", "images")
"""The files of a COLMAP model that its cameras need."""

Size = tuple[int, int]
"""Width and height [pixels]."""


class NoSizeError(ValueError):
    """The entry states no size, and its image is not there to ask."""


@dataclass(frozen=True)
class CameraEntry:
    """One image of a camera file."""

    where: str  # such as "cameras.json: camera 3"
    file: str  # as written, with its suffix where it was found without
    read: Callable[[Size | None], PosedCamera]

    def camera(self, size: Size | None = None) -> PosedCamera:
        """What it says, for an image of `size` where it states none itself.

        Raises InputError naming what is wrong.
        """
        with _faults_named(self.where):
            return self.read(size)


@contextmanager
def _faults_named(where: str) -> Iterator[None]:
    try:
        yield
    except NoSizeError:
        raise
    except KeyError as error:
        raise InputError(f"{where} lacks {error.args[0]!r}.") from None
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{where} cannot be used ({error}).") from None


def json_entries(path: Path) -> list[CameraEntry]:
    """The entries of a camera file in JSON, told apart by content. Raises InputError."""
    content = _read_json(path)
    dialect = _Dialect("file", _from_list_entry)
    if isinstance(content, dict) and isinstance(content.get("frames"), list):
        # What is said at the top holds for every frame.
        top = {name: value for name, value in content.items() if name != "frames"}
        content = [
            ChainMap(f, top) if isinstance(f, dict) else f for f in content["frames"]
        ]
        dialect = _Dialect("file_path", _from_frame)
    if not isinstance(content, list):
        raise InputError(
            f"{path}: expected a list of cameras, or nerfstudio's layout with 'frames'."
        )
    if content and isinstance(content[0], dict) and "img_name" in content[0]:
        dialect = _Dialect("img_name", _from_trained)
    return [
        dialect.entry(entry, path.parent, f"{path}: camera {index}")
        for index, entry in enumerate(content)
    ]


@dataclass(frozen=True)
class _Dialect:
    name: str  # of the key with the image
    parse: Callable[[Mapping[str, Any], Path, Size | None], PosedCamera]

    def entry(self, content: Any, folder: Path, where: str) -> CameraEntry:
        with _faults_named(where):
            file = _existing(folder, file_name(content[self.name]))
        return CameraEntry(where, file, partial(self._read, content, folder, file))

    def _read(
        self, content: Any, folder: Path, file: str, size: Size | None
    ) -> PosedCamera:
        named = content.get("mask_path")
        mask = _existing(folder, file_name(named)) if named else ""
        return replace(self.parse(content, folder / file, size), file=file, mask=mask)


def _existing(folder: Path, file: str) -> str:
    """The image's path where it is written with backslashes or without its suffix."""
    if "\\" in file and not (folder / file).is_file():
        file = file_name(file.replace("\\", "/"))
    if Path(file).suffix.lower() in SUFFIXES or (folder / file).is_file():
        return file
    endings = (ending for one in SUFFIXES for ending in (one, one.upper()))
    named = (f"{file}{ending}" for ending in endings)
    return next((name for name in named if (folder / name).is_file()), file)


def _read_json(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such camera file.")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(
                f"{path}: {path.stat().st_size / 1e6:.0f} MB, expected a camera file of at most "
                f"{MOST_BYTES / 1e6:.0f} MB."
            )
        return parse_json(path.read_bytes(), finite=False)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error}).") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from None


def _from_list_entry(
    entry: Mapping[str, Any], image: Path, size: Size | None
) -> PosedCamera:
    width, height = size_from_outside(entry["width"], entry["height"])
    k = intrinsics_from_outside(entry.get("K"), width, height)
    pose = pose_from_outside(entry.get("c2w"), "c2w")
    return PosedCamera(image.name, width, height, k, pose)


def _from_trained(
    entry: Mapping[str, Any], image: Path, size: Size | None
) -> PosedCamera:
    """Of the list that 3D Gaussian Splatting leaves beside its scene."""
    width, height = size_from_outside(entry["width"], entry["height"])
    fx, fy = float(entry["fx"]), float(entry["fy"])
    cx, cy = float(entry.get("cx", width / 2)), float(entry.get("cy", height / 2))
    k = intrinsics_from_outside([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], width, height)
    turn = np.array(entry["rotation"], dtype=np.float64)
    place = np.array(entry["position"], dtype=np.float64)
    require(
        turn.shape == (3, 3) and place.shape == (3,),
        "expected a rotation of 3x3 and a position of 3 numbers",
    )
    pose = pose_from_outside(np.column_stack((turn, place)), "rotation and position")
    return PosedCamera(image.name, width, height, k, pose)


def _from_frame(
    frame: Mapping[str, Any], image: Path, size: Size | None
) -> PosedCamera:
    distortion = _distortion(frame)
    width, height = _size_of_frame(frame, image, size)
    pose = pose_from_outside(frame.get("transform_matrix"), "transform_matrix")
    return PosedCamera(
        image.name,
        width,
        height,
        K=_frame_intrinsics(frame, width, height),
        c2w=None if pose is None else pose @ OPENGL_TO_OPENCV,
        distortion=distortion,
    )


def _distortion(frame: Mapping[str, Any]) -> tuple[float, ...]:
    """The lens of a frame in OpenCV's numbers; raises ValueError for one that is none of its."""
    model = str(frame.get("camera_model") or "PINHOLE").upper()
    require(
        model in _PINHOLES,
        f"camera model {model}, expected a pinhole; undistort the photos first",
    )
    for name in _OTHER_LENSES:
        require(
            not frame.get(name),
            f"{name}: a fisheye or panorama, expected a pinhole; undistort the photos first",
        )
    names = _DISTORTION + _RATIONAL * (model == "FULL_OPENCV")
    distortion = tuple(_number(frame, name) for name in names)
    for name in _RATIONAL:
        require(
            name in names or not _number(frame, name),
            f"{name} is {frame.get(name)}, which cannot be undone; undistort the photos first",
        )
    return lens_numbers(distortion)


def lens_numbers(distortion: tuple[float, ...]) -> tuple[float, ...]:
    """OpenCV's numbers as they are used; raises ValueError where they are no lens."""
    Lens((1.0, 1.0), (0.5, 0.5), distortion)
    return distortion if any(distortion) else ()


def _size_of_frame(frame: Mapping[str, Any], image: Path, size: Size | None) -> Size:
    if "w" in frame and "h" in frame:
        return size_from_outside(frame["w"], frame["h"])
    if size is not None:
        return size
    if not image.is_file():
        raise NoSizeError(f"{image}: no such file, and no size (w, h) is stated")
    height, width = image_size(image)
    return width, height


def _frame_intrinsics(
    frame: Mapping[str, Any], width: int, height: int
) -> Matrix3 | None:
    x = _focal(frame, "fl_x", "camera_angle_x", width)
    y = _focal(frame, "fl_y", "camera_angle_y", height)
    if x is None and y is None:
        return None
    # One angle alone means square pixels.
    cx, cy = frame.get("cx"), frame.get("cy")
    rows = [
        [y if x is None else x, 0, width / 2 if cx is None else float(cx)],
        [0, x if y is None else y, height / 2 if cy is None else float(cy)],
        [0, 0, 1.0],
    ]
    return intrinsics_from_outside(rows, width, height)


def _number(frame: Mapping[str, Any], name: str) -> float:
    """A number of a frame; 0 where it is not stated."""
    value = frame.get(name)
    return 0.0 if value is None else float(value)


def _focal(frame: Mapping[str, Any], focal: str, angle: str, size: int) -> float | None:
    if frame.get(focal) is not None:
        return float(frame[focal])
    if frame.get(angle) is None:
        return None
    radians = float(frame[angle])
    require(
        0 < radians < math.pi,
        f"{angle} is {radians:g}, expected radians above 0 and below pi",
    )
    return 0.5 * size / math.tan(0.5 * radians)


def ending_of(model: Path) -> str:
    """ ".bin" or ".txt" for the folder of a COLMAP model; "" for one of anything else."""
    for ending in (".bin", ".txt"):
        if all((model / f"{part}{ending}").is_file() for part in MODEL_PARTS):
            return ending
    return ""
