"""Camera files: our `cameras.json`, and those of other programs.

`cameras.json` is a list of `{file, width, height, K, c2w}`: `file` relative to the list's folder,
`K` 3x3 in pixels of the upright image with the centre of its top-left pixel at (0.5, 0.5), `c2w`
4x4 camera to world with OpenCV axes (x right, y down, z forward). `K` and `c2w` may be null.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import warn
from edit3r.contract.types import Cameras
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.geometry.cameras import to_pixels
from edit3r.kit.photos.camera_entries import (
    CameraEntry,
    NoSizeError,
    PosedCamera,
    ending_of,
    intrinsics_from_outside,
    json_entries,
    pose_from_outside,
)

__all__ = [
    "CAMERA_FILES",
    "PosedCamera",
    "camera_entries",
    "intrinsics_from_outside",
    "pose_from_outside",
    "posed_cameras",
    "read_cameras",
    "read_scene_cameras",
    "write_cameras",
]

SPLITS = tuple(f"transforms_{part}.json" for part in ("train", "test", "val"))
"""The files of one scene, in one frame, as NeRF's data sets have them."""

CAMERA_FILES = ("cameras.json", "transforms.json", *SPLITS)
"""Names looked for beside photos, in this order; then COLMAP's models."""

MODELS = (".", "sparse/0", "sparse", "colmap/sparse/0", "0")
"""Where COLMAP's models lie in the folder of a scene."""


def camera_files_in(folder: Path) -> list[Path]:
    """The camera files of a folder, in the order in which they are asked."""
    listed = [folder / name for name in CAMERA_FILES if (folder / name).is_file()]
    return listed + [folder / one for one in MODELS if ending_of(folder / one)][:1]


def camera_entries(path: str | Path) -> list[CameraEntry]:
    """The entries of a camera file, or of a folder with one; of a COLMAP model by its folder, the
    folder of its scene, or one of its files. Raises InputError naming what is wrong.
    """
    path = Path(path)
    if path.suffix.lower() in (".bin", ".txt") and path.is_file():
        path = path.parent
    if not path.is_dir():
        return json_entries(path)
    camera_files = camera_files_in(path)
    if not camera_files:
        raise InputError(
            f"{path}: holds neither a COLMAP model (cameras and images, .bin or .txt) nor a "
            f"{' or a '.join(CAMERA_FILES[:2])}."
        )
    if camera_files[0].is_file():
        return json_entries(camera_files[0])
    # pycolmap takes a quarter of a second to import
    from edit3r.kit.photos.colmap import colmap_entries

    return colmap_entries(camera_files[0])


def read_cameras(path: str | Path) -> list[PosedCamera]:
    """Read a camera file of any kind, told apart by content.

    What states no size and whose image is gone is left out with a warning. Raises InputError naming
    what is wrong.
    """
    cameras: list[PosedCamera] = []
    gone: list[NoSizeError] = []
    for entry in camera_entries(path):
        try:
            cameras.append(entry.camera())
        except NoSizeError as error:
            gone.append(error)
    if gone and not cameras:
        raise InputError(f"{path}: {gone[0]}.")
    if gone:
        warn(f"{path}: left out, with {len(gone) - 1} more: {gone[0]}.")
    return cameras


def read_scene_cameras(path: str | Path) -> tuple[Cameras, list[PosedCamera]]:
    """The cameras of a file that have a pose and intrinsics, at the first one's image size."""
    if not Path(path).exists():
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
    """Write `cameras.json`, one camera a line; 9 significant digits keep float32 exactly."""
    lines = []
    for camera in cameras:
        entry = {"file": camera.file, "width": camera.width, "height": camera.height}
        entry |= {"K": _rounded(camera.K), "c2w": _rounded(camera.c2w)}
        lines.append(json.dumps(entry, allow_nan=False))
    with atomic_write(path) as partial:
        partial.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


def _rounded(matrix: np.ndarray | None) -> list[list[float]] | None:
    if matrix is None:
        return None
    return [[float(f"{number:.9g}") for number in row] for row in matrix]
