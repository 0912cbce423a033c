"""A folder of photos with known cameras, as evaluation uses it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64

from edit3r.contract.errors import InputError
from edit3r.kit.photos.camera_files import (
    CAMERA_FILES,
    PosedCamera,
    camera_files_in,
    read_cameras,
)
from edit3r.kit.photos.decode import read_image
from edit3r.kit.photos.framing import frame_for

__all__ = ["PosedFolder", "PosedPhoto", "read_posed_folder"]


@dataclass(frozen=True)
class PosedPhoto:
    """One image ready for evaluation: square, with the camera that took it."""

    image: np.ndarray  # [size, size, 3] sRGB in [0, 1], float32
    intrinsics: np.ndarray  # [3, 3] normalised
    c2w: np.ndarray  # [4, 4]


@dataclass(frozen=True)
class PosedFolder:
    """A scene: the photos of a camera file that have a pose and intrinsics, in the file's order."""

    name: str
    path: Path
    cameras: tuple[PosedCamera, ...]

    @property
    def poses(self) -> list[Float64[np.ndarray, "4 4"]]:
        """Camera-to-world matrices of all photos."""
        return [camera.c2w for camera in self.cameras if camera.c2w is not None]

    def load(self, index: int, size: int) -> PosedPhoto:
        """The largest centred square of a photo, undistorted and resized to `size`."""
        camera = self.cameras[index]
        assert camera.intrinsics is not None and camera.c2w is not None  # as was read
        image = read_image(self.path / camera.file)
        frame = frame_for((image.height, image.width), (size, size)).through(
            camera.lens
        )
        intrinsics = frame.follow(torch.from_numpy(camera.intrinsics)).numpy()
        return PosedPhoto(
            np.asarray(frame.cut(image), np.float32) / 255, intrinsics, camera.c2w
        )


def read_posed_folder(path: str | Path) -> PosedFolder:
    """Read the folder's camera file. Raises InputError naming the file and what it lacks."""
    path = Path(path)
    camera_files = camera_files_in(path)
    if not camera_files:
        raise InputError(
            f"{path}: expected a folder of photos with a {' or a '.join(CAMERA_FILES)}, or with a "
            "COLMAP model."
        )
    # COLMAP's names are those in the folder of images, wherever that is.
    images = "images" if camera_files[0].is_dir() and (path / "images").is_dir() else ""
    cameras = tuple(
        replace(camera, file=str(Path(images, camera.file)))
        for camera in read_cameras(camera_files[0])
        if camera.K is not None and camera.c2w is not None
    )
    if not cameras:
        raise InputError(
            f"{camera_files[0]}: no photo has both a pose (c2w) and intrinsics (K)."
        )
    return PosedFolder(path.resolve().name, path, cameras)
