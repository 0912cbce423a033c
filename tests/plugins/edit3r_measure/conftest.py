"""A textured wall and photos of it whose cameras are known, and a reconstructor that knows the
wall.
"""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.photos.camera_files import PosedCamera
from edit3r.kit.photos.posed_folder import read_posed_folder

DEPTH = 4.0  # of the wall that all photos show


def camera(x, degrees, file="a.png", width=96, height=64):
    c2w = np.eye(4)
    c2w[:3, :3] = cv2.Rodrigues(np.array([0, np.radians(degrees), 0]))[0]
    c2w[0, 3] = x
    lens = np.array([[80.0, 0, width / 2], [0, 80, height / 2], [0, 0, 1]])
    return PosedCamera(file, width, height, lens, c2w)


def photo_of_wall(camera):
    """A textured wall at z = DEPTH, seen by `camera`."""
    coarse = np.random.default_rng(0).random((24, 48, 3))
    grain = cv2.resize(coarse, (960, 480), interpolation=cv2.INTER_CUBIC)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x, y, np.ones_like(x)], -1)
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.c2w[:3, :3].T
    wall = rays / rays[..., 2:] * DEPTH + camera.c2w[:3, 3]
    u, v = (wall[..., 0] + 6) / 12 * 959, (wall[..., 1] + 3) / 6 * 479
    places = u.astype(np.float32), v.astype(np.float32)
    seen = cv2.remap(grain, *places, cv2.INTER_LINEAR)
    return (np.clip(seen, 0, 1) * 255).astype(np.uint8)


def written(folder, cameras):
    """Save what the cameras see and give their entries for a camera file."""
    for camera in cameras:
        Image.fromarray(photo_of_wall(camera)).save(folder / camera.file)
    sizes = [{"file": c.file, "width": c.width, "height": c.height} for c in cameras]
    return [
        {**size, "K": c.K.tolist(), "c2w": c.c2w.tolist()}
        for size, c in zip(sizes, cameras)
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "wall"
    path.mkdir()
    places = enumerate(((-0.4, 4), (0, 0), (0.4, -4)))
    entries = written(path, [camera(x, turn, f"{i}.png") for i, (x, turn) in places])
    lost = {"file": "lost.png", "width": 9, "height": 9, "K": None, "c2w": None}
    entries.append(lost)
    (path / "cameras.json").write_text(json.dumps(entries))
    return read_posed_folder(path)


class WallKnown(Reconstructor):
    """Puts the pixels of view 0 on the true wall, in a unit of length of its own."""

    unit = 2.5

    def __init__(self, folder, fails=False):
        self.folder, self.fails = folder, fails

    def __call__(self, views, source=None, geometry=None, grid=None):
        if self.fails:
            raise MatchingError("nothing in common.")
        first, second = (self.folder.cameras[i].c2w for i in (0, 2))
        size = views.image_size
        y, x = ((np.arange(side) + 0.5) / side for side in size)
        x, y = np.meshgrid(x, y)
        lens = np.linalg.inv(views.intrinsics[0, 0].double().numpy())
        rays = np.stack([x, y, np.ones_like(x)], -1) @ lens.T
        depth = DEPTH / (rays @ first[:3, :3].T)[..., 2:]
        points = torch.from_numpy(self.unit * rays * depth).float().reshape(1, -1, 3)
        c2w = np.stack([np.eye(4), np.linalg.inv(first) @ second])
        c2w[:, :3, 3] *= self.unit
        count = points.shape[1]
        gaussians = Gaussians(
            points,
            torch.full((1, count, 3), 0.4 * self.unit * DEPTH / 80),
            torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
            torch.full((1, count), 0.8),
            colour_to_dc(views.images[0, 0].permute(1, 2, 0)).reshape(1, count, 1, 3),
        )
        pose = torch.from_numpy(c2w).float()[None]
        return Reconstruction(gaussians, Cameras(pose, views.intrinsics, size))


@pytest.fixture(scope="session")
def wall():
    """What makes a wall: `camera`, `written` and the reconstructor `Known`."""
    return SimpleNamespace(camera=camera, written=written, Known=WallKnown)
