"""From where a saved scene is looked at: the cameras beside it, or looks from outside."""

import math
from pathlib import Path

import torch

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import say, warn
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import intrinsics_from_fov
from edit3r.kit.geometry.rotations import cross_matrix
from edit3r.kit.photos.camera_files import (
    PosedCamera,
    camera_files_in,
    posed_cameras,
    read_scene_cameras,
)
from edit3r.kit.scenes.axes import LEAST_OPACITY
from edit3r.kit.scenes.files import TRAINED

# The numbers of this block: sanity limits.
SIZE = (480, 640)  # of a look from outside: height, width [pixels]
VIEW = 60.0  # its horizontal field of view [degrees]
CORE = 0.9  # share of the Gaussians, on each axis, that it takes in
MOST = 1_000_000  # Gaussians that it goes by
SIDES = {
    "front": (0.0, 0.0, 0.0),
    "right": (0.0, -90.0, 0.0),
    "back": (0.0, 180.0, 0.0),
    "left": (0.0, 90.0, 0.0),
    "above": (-90.0, 0.0, 0.0),
    "below": (90.0, 0.0, 0.0),
}
"""How a camera that looks along z is turned about x, y or z [degrees]; y is down."""


def camera_file_of(scene: Path) -> Path | None:
    """The camera file beside a scene, or where 3D Gaussian Splatting leaves it, two folders up."""
    folders = [scene.parent]
    if TRAINED.fullmatch(scene.absolute().parent.name):
        folders.append(scene.absolute().parents[2])
    camera_files = (file for folder in folders for file in camera_files_in(folder))
    return next(camera_files, None)


def look_at(
    scene: Path, given: str | None, gaussians: Gaussians, sides: int = 4
) -> tuple[Cameras, list[PosedCamera]]:
    """The cameras that were given or lie beside the scene; else looks from outside, which is said.

    Raises InputError for a given file that cannot be used; one that was found is passed over.
    """
    if given:
        return read_scene_cameras(given)
    beside = camera_file_of(scene)
    if beside is not None:
        try:
            return read_scene_cameras(beside)
        except InputError as error:
            warn(f"{error} It is ignored.")
    say(
        "cameras.made_up",
        f"none lie beside {scene}; it is looked at from outside. Give --cameras FILE for other "
        "places",
    )
    cameras = from_outside(gaussians, sides)
    return cameras, posed_cameras(cameras, [f"{name}.png" for name in [*SIDES][:sides]])


def from_outside(gaussians: Gaussians, sides: int = 4) -> Cameras:
    """Cameras at the first of `SIDES` that look at the middle of a scene (batch 1)."""
    drawn = gaussians.means[0, gaussians.opacities[0] >= LEAST_OPACITY].double()
    drawn = drawn[:: len(drawn) // MOST + 1].cpu()
    share = torch.tensor([(1 - CORE) / 2, 0.5, (1 + CORE) / 2]).double()
    low, middle, high = drawn.quantile(share, 0)
    # A ball around the middle that holds the core: it fits from every side.
    radius = torch.maximum(high - middle, middle - low).norm().clamp(min=1e-6)
    narrow = math.radians(VIEW) / 2 * min(SIZE) / max(SIZE)
    turns = torch.tensor([*SIDES.values()][:sides]).double().deg2rad()
    poses = torch.eye(4).double().repeat(sides, 1, 1)
    poses[:, :3, :3] = torch.linalg.matrix_exp(cross_matrix(turns))
    poses[:, :3, 3] = middle - radius / math.sin(narrow) * poses[:, :3, 2]
    lens = intrinsics_from_fov(math.radians(VIEW), SIZE).expand(1, sides, 3, 3)
    return Cameras(poses.float()[None], lens.float(), SIZE)
