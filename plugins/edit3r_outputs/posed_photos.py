"""A run's images and cameras as programs read them that make scenes of photos: COLMAP's model, and
nerfstudio's `transforms.json`.

Both have the centre of the top-left pixel at (0.5, 0.5), as `cameras.json` has.
"""

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8

from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import invert_rigid, to_pixels
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.rotations import matrices_to_quats
from edit3r.kit.photos.camera_entries import OPENGL_TO_OPENCV
from edit3r.kit.photos.images import save_image
from edit3r_outputs.mesh_ply import coloured_ply

MAX_POINTS = 100_000  # as many as COLMAP finds in some hundred photos
POINTS = "sparse_pc.ply"  # as nerfstudio calls it
_PINHOLE = 1  # COLMAP's number of the model with fx, fy, cx, cy
_POINT = [("id", "<u8"), ("position", "<f8", 3), ("colour", "u1", 3)]
_POINT += [("error", "<f8"), ("track_length", "<u8")]  # 0: found by no matching


class ColmapWriter(Writer):
    """COLMAP's binary model in `sparse/0`, with means of the scene as points without tracks."""

    needs = ("cameras", "edited", "names")

    def write(self, path: Path, scene: SceneToWrite) -> None:
        assert scene.cameras is not None  # they are needed
        names = _write_images(path, scene)
        _write_colmap(path / "sparse" / "0", scene.cameras, names, scene.gaussians)


class NerfstudioWriter(Writer):
    """nerfstudio's `transforms.json`, with the points that splatfacto begins with."""

    needs = ("cameras", "edited", "names")

    def write(self, path: Path, scene: SceneToWrite) -> None:
        assert scene.cameras is not None  # they are needed
        files = [f"images/{name}" for name in _write_images(path, scene)]
        write_transforms(path / "transforms.json", scene.cameras, files, POINTS)
        (path / POINTS).write_bytes(coloured_ply(*_points(scene.gaussians)))


def _write_images(folder: Path, scene: SceneToWrite) -> list[str]:
    """Write the edited images, which the scene shows, into `images`, and return their names."""
    assert scene.edited is not None  # they are needed
    (folder / "images").mkdir(parents=True)
    names = [f"{name}.png" for name in scene.names]
    for name, image in zip(names, scene.edited.images[0], strict=True):
        save_image(image, folder / "images" / name)
    return names


def _write_colmap(
    folder: Path, cameras: Cameras, names: Sequence[str], gaussians: Gaussians
) -> None:
    """COLMAP's binary model, whose images may have spaces in their names."""
    folder.mkdir(parents=True)
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0].double(), cameras.image_size).tolist()
    poses = invert_rigid(cameras.c2w[0].double())
    turns = matrices_to_quats(poses[:, :3, :3]).tolist()
    places = poses[:, :3, 3].tolist()
    lenses = images = struct.pack("<Q", len(names))
    for index, ((fx, _, cx), (_, fy, cy), _) in enumerate(pixels):
        key = index + 1
        lenses += struct.pack("<Ii2Q4d", key, _PINHOLE, width, height, fx, fy, cx, cy)
        images += struct.pack("<I7dI", key, *turns[index], *places[index], key)
        images += names[index].encode() + b"\0" + struct.pack("<Q", 0)  # no matches
    (folder / "cameras.bin").write_bytes(lenses)
    (folder / "images.bin").write_bytes(images)

    means, colours = _points(gaussians)
    points = np.zeros(len(means), _POINT)
    points["id"] = np.arange(1, len(means) + 1)
    points["position"], points["colour"] = means, colours
    content = struct.pack("<Q", len(points)) + points.tobytes()
    (folder / "points3D.bin").write_bytes(content)


def _points(
    gaussians: Gaussians,
) -> tuple[Float[np.ndarray, "point 3"], UInt8[np.ndarray, "point 3"]]:
    """Centres and colours of at most `MAX_POINTS` Gaussians."""
    step = gaussians.count // MAX_POINTS + 1
    means = gaussians.means[0, ::step].cpu().numpy()
    colours = dc_to_colour(gaussians.harmonics[0, ::step, 0]).clamp(0, 1).cpu()
    return means, (colours * 255).round().byte().numpy()


def write_transforms(
    path: Path, cameras: Cameras, files: Sequence[str], points: str = ""
) -> None:
    """Write the cameras of one scene (batch 1) as nerfstudio's `transforms.json`.

    `points` names a PLY beside it with points of the same world, from which Gaussians may begin.
    """
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0].double(), cameras.image_size).tolist()
    poses = (cameras.c2w[0].double() @ torch.from_numpy(OPENGL_TO_OPENCV)).tolist()
    frames = []
    for file, ((fx, _, cx), (_, fy, cy), _), pose in zip(files, pixels, poses):
        frame = {"file_path": file, "w": width, "h": height}
        frame |= {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "transform_matrix": pose}
        frames.append(frame)
    content: dict[str, Any] = {"camera_model": "PINHOLE", "frames": frames}
    if points:
        content["ply_file_path"] = points
    path.write_text(json.dumps(content, indent=1, allow_nan=False), "utf-8")
