"""COLMAP's models, in text and binary, read by pycolmap: the cameras and poses, not the points."""

import shutil
import struct
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from edit3r.contract.errors import InputError
from edit3r.kit.geometry.quiet_pycolmap import pycolmap
from edit3r.kit.photos.camera_entries import (
    MODEL_PARTS,
    CameraEntry,
    PosedCamera,
    Size,
    ending_of,
    file_name,
    intrinsics_from_outside,
    lens_numbers,
    pose_from_outside,
    require,
    size_from_outside,
)

MOST_BYTES = 2 * 10**9  # of one file: 10,000 photos with 8,000 points each
_LEAST_CAMERA = 24 + 3 * 8  # bytes of one with three numbers
_IMAGE = 64  # bytes of one before its name
_POINT = 24  # bytes of a point in an image
# OpenCV's numbers, as places among COLMAP's parameters after focal lengths and centre
_LENSES = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 0,
    "SIMPLE_RADIAL": 1,
    "RADIAL": 2,
    "OPENCV": 4,
    "FULL_OPENCV": 8,
}


def colmap_entries(folder: Path) -> list[CameraEntry]:
    """The images of a model that have a pose. Raises InputError for a damaged model."""
    try:
        with tempfile.TemporaryDirectory() as scratch:
            names = _copy_without_points(folder, Path(scratch))
            model = pycolmap.Reconstruction(scratch)
        names = names or {key: image.name for key, image in model.images.items()}
    except (ValueError, IndexError, OSError, RuntimeError) as error:
        reason = str(error).rpartition("] ")[2].strip()
        raise InputError(
            f"{folder}: no COLMAP model that can be read ({reason[:200]})."
        ) from None
    entries = []
    for key in sorted(model.images):
        image = model.images[key]
        if image.has_pose:
            read = partial(_camera, image, model.cameras[image.camera_id], names[key])
            entries.append(CameraEntry(f"{folder}: image {key}", names[key], read))
    return entries


def _copy_without_points(folder: Path, scratch: Path) -> dict[int, str]:
    """Copy a model without its points, which may be gigabytes, or missing.

    Returns the names of a text's images, under which their keys then stand: pycolmap cuts names at
    a space, and needs a line for the points of each image, which those who write by hand leave out.
    """
    ending = ending_of(folder)
    for part in MODEL_PARTS:
        source = folder / f"{part}{ending}"
        if source.is_file():
            _check_size(source)
            shutil.copyfile(source, scratch / source.name)
    (scratch / f"points3D{ending}").write_bytes(bytes(8) if ending == ".bin" else b"")
    if ending == ".bin":
        _check_counts(scratch)
        return {}
    text = (folder / "images.txt").read_text("utf-8-sig", errors="surrogateescape")
    lines = [line.split(maxsplit=9) for line in text.splitlines()]
    images = [fields for fields in lines if _is_image(fields)]
    text_of_images = "".join(
        f"{' '.join(fields[:9])} {fields[0]}\n\n" for fields in images
    )
    (scratch / "images.txt").write_text(text_of_images, "utf-8")
    return {int(fields[0]): fields[9].strip() for fields in images}


def _check_size(file: Path) -> None:
    """Raise ValueError for what no model of photos takes: it would be read into memory."""
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(
            f"{file.name} has {size / 1e9:.0f} GB; at most {MOST_BYTES / 1e9:.0f} are read"
        )


def _check_counts(scratch: Path) -> None:
    """Raise ValueError for files that promise more than they hold: pycolmap would read on."""
    cameras, images = ((scratch / f"{part}.bin").read_bytes() for part in MODEL_PARTS)
    try:
        if struct.unpack_from("<Q", cameras)[0] * _LEAST_CAMERA > len(cameras):
            raise ValueError("it is cut off")
        place = 8
        for _ in range(struct.unpack_from("<Q", images)[0]):
            name_end = images.index(b"\0", place + _IMAGE)
            (points,) = struct.unpack_from("<Q", images, name_end + 1)
            place = name_end + 9 + points * _POINT
    except (struct.error, OverflowError):
        raise ValueError("it is cut off") from None
    if place > len(images):
        raise ValueError("it is cut off")


def _is_image(fields: list[str]) -> bool:
    """Whether a line of `images.txt` is an image's, and not that of its points: numbers alone."""
    return (
        len(fields) == 10
        and fields[0].isdecimal()
        and not _is_number(fields[9].split()[0])
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _camera(
    image: pycolmap.Image, camera: pycolmap.Camera, name: str, size: Size | None
) -> PosedCamera:
    model = camera.model_name
    require(
        model in _LENSES,
        f"camera model {model}, expected a pinhole; undistort the photos first",
    )
    width, height = size_from_outside(camera.width, camera.height)
    numbers = [float(value) for value in camera.params]
    distortion = numbers[len(numbers) - _LENSES[model] :] if _LENSES[model] else []
    turn = image.cam_from_world().rotation.quat
    require(
        np.linalg.norm(turn) > 0.5, "its quaternion is of zeros, which is no rotation"
    )
    pose = np.linalg.inv(np.vstack((image.cam_from_world().matrix(), (0, 0, 0, 1))))
    return PosedCamera(
        file_name(name),
        width,
        height,
        intrinsics_from_outside(camera.calibration_matrix(), width, height),
        pose_from_outside(pose, "the pose"),
        lens_numbers(tuple(distortion)),
    )
