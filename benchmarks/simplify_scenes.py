"""Scenes for `benchmarks/simplify.py`: real photos, generated ones, and a flat wall."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from edit3r_measure.evaluation.novel_view import relative_pose
from edit3r_measure.evaluation.pairs import choose_triples

import edit3r
from edit3r.geometry.cameras import intrinsics_from_fov, unproject
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.io.posed_folder import Photo, read_posed_folder
from edit3r.types import Cameras, Gaussians, Reconstruction

WALL_DEPTH, WALL_STEP = 2.0, 0.1  # of the flat wall, and between its two cameras [scene units]


@dataclass(frozen=True)
class HeldOut:
    """Two photos to reconstruct from and the one between them to predict."""

    kind: str  # "real" or "procedural"
    label: str
    first: Photo
    second: Photo
    target: Photo

    def novel_camera(self, scene: Reconstruction) -> Cameras:
        """The target's camera in the scene's frame and unit of length: the predicted baseline is the true one."""
        pose = relative_pose(self.target, self.first)
        predicted = float(scene.cameras.c2w[0, 1, :3, 3].norm())
        pose[:3, 3] *= predicted / np.linalg.norm(relative_pose(self.second, self.first)[:3, 3])
        c2w, intrinsics = (torch.from_numpy(matrix).float()[None, None] for matrix in (pose, self.target.intrinsics))
        return Cameras(c2w, intrinsics, self.target.image.shape[:2])


def real_scenes(folders: Sequence[str], pairs: int, size: int, skip: int = 0) -> Iterator[HeldOut]:
    """Up to `pairs` triples of each folder of posed photos, without the first `skip` of them."""
    for name in folders:
        folder = read_posed_folder(name)
        for triple in choose_triples(folder.cameras, pairs)[skip:]:
            photos = (folder.load(i, size) for i in (triple.first, triple.second, triple.target))
            yield HeldOut("real", f"{Path(name).name} {triple.first}-{triple.second}", *photos)


def procedural_scenes(count: int, size: int, seed: int = 99) -> Iterator[HeldOut]:
    """Generated rooms and open grounds that no training has seen (a seed of their own)."""
    data = edit3r.build("dataset", "procedural", scenes=count, seed=seed, image_size=size, targets=1, angles=[5, 20])
    for index in range(count):
        sample = data[index]
        photos = [*_photos(sample.context, sample.context_cameras), *_photos(sample.target, sample.target_cameras)]
        yield HeldOut("procedural", f"procedural {seed}-{index}", *photos)


def _photos(images: torch.Tensor, cameras: Cameras) -> list[Photo]:
    return [
        Photo(image.permute(1, 2, 0).numpy(), cameras.intrinsics[0, i].double().numpy(), cameras.c2w[0, i].numpy())
        for i, image in enumerate(images)
    ]


def flat_wall(size: int) -> Reconstruction:
    """Two views of a grey wall, one Gaussian per pixel, by formula."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = WALL_STEP
    cameras = Cameras(c2w, intrinsics_from_fov(0.9, (size, size)).repeat(1, 2, 1, 1), (size, size))
    means = unproject(torch.full((2, size, size), WALL_DEPTH), cameras.intrinsics[0], c2w[0]).reshape(1, -1, 3)
    pixel = WALL_DEPTH / float(cameras.intrinsics[0, 0, 0, 0]) / size
    gaussians = Gaussians(
        means,
        torch.full_like(means, pixel / 2),
        torch.tensor([1.0, 0, 0, 0]).repeat(1, means.shape[1], 1),
        torch.full(means.shape[:2], 0.9),
        colour_to_dc(torch.full((1, means.shape[1], 1, 3), 0.6)),
        torch.arange(2).repeat_interleave(size * size),
    )
    return Reconstruction(gaussians, cameras)
