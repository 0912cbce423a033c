"""How much stands in front of what the photos measured, and what `clean` would take.

    python benchmarks/floaters.py photos/ --only "fern 0,10" "monstree 4,5,6"

A row a set of photos, reconstructed by the default run with unknown lens and poses. Seen from a
quarter, half and three quarters of the way between neighbouring photos: the share of the pixels
with a measured depth whose surface stands more than a twentieth before the nearest one that any
photo measured there (3 x 3 pixels). Then what `clean` takes of the Gaussians, and the share of the
photos' pixels that change by it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from edit3r_refiners.api import find_floaters
from harness import Row, for_tuning, run_benchmark
from jaxtyping import Float
from poses import MATCHER
from torch import Tensor

import edit3r
from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.photos.images import find_photos

SETS = (
    *("bear 0,2", "bear 20,22", "bear 8,10,12", "fern 0,10", "fern 0,4,8", "fox 0,3"),
    *("fox 10,14,18", "monstree 0,1", "monstree 4,5,6", "7scenes_rgbd 0,3"),
    *("soh_pair 0,1", "stereo_motorcycle 0,1"),
)
BEFORE = 0.05  # share of the measured depth
SIZE = 512


def main(data: Path, *, only: Sequence[str] = SETS) -> Iterator[Row]:
    for name in only:
        folder, _, numbers = name.partition(" ")
        for_tuning([folder])
        files = find_photos(data / folder / "images")
        given = [files[int(number)] for number in numbers.split(",")]
        views = replace(edit3r.load_views(given, size=SIZE, cameras="none"), c2w=None)
        result = edit3r.run(views, editor="none", outputs=[])
        matcher = edit3r.build("matcher", "classical", **MATCHER)
        geometry = matcher.match(views).at(views.image_size)
        lens = geometry.calibrated(views).intrinsics
        floaters = find_floaters(result.gaussians, result.cameras, result.rasterizer)
        yield {
            "photos": name,
            "in front, %": (100 * in_front(result, geometry, lens), ".2f"),
            "clean takes, %": (100 * float(floaters.found.float().mean()), ".2f"),
            "pixels it changes, %": (100 * floaters.changed, ".2f"),
        }


@torch.no_grad()
def in_front(result: edit3r.RunResult, geometry: Geometry, lens: Tensor) -> float:
    """Mean share of the pixels whose surface stands before all that was measured there."""
    points = unproject(geometry.depths, lens, geometry.c2w)[0]
    sure = (geometry.confidence[0] >= 0.5) & geometry.registered[0][:, None, None]
    shares = []
    for camera in between(result.cameras):
        nearest = nearest_depths(points[sure], camera)
        shown = result.rasterizer.render(result.gaussians, camera)
        depths = shown.depths.view_as(nearest)
        front = (shown.alphas.view_as(nearest) > 0.5) & nearest.isfinite()
        front &= depths < (1 - BEFORE) * nearest
        shares.append(float(front.sum() / nearest.isfinite().sum()))
    return sum(shares) / len(shares)


def between(cameras: Cameras) -> Iterator[Cameras]:
    """A quarter, half and three quarters of the way from each camera to the next."""
    for first in range(cameras.count - 1):
        start, end = cameras.c2w[0, first : first + 2].double()
        for share in (0.25, 0.5, 0.75):
            pose = interpolate_poses(start, end, torch.tensor(share).double())
            yield replace(cameras.select([first]), c2w=pose.float()[None, None])


def nearest_depths(
    points: Float[Tensor, "point 3"], camera: Cameras
) -> Float[Tensor, "height width"]:
    """Camera z of the nearest point around each pixel; infinite where there is none."""
    height, width = camera.image_size
    places, depth = project(points, camera.intrinsics[0, 0], camera.c2w[0, 0])
    column, row = (places * places.new_tensor([width, height])).floor().long().T
    nearest = torch.full((height * width,), torch.inf)
    for right in (-1, 0, 1):
        for down in (-1, 0, 1):
            x, y = column + right, row + down
            inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
            index = (y * width + x)[inside]
            nearest.scatter_reduce_(0, index, depth[inside], "amin")
    return nearest.view(height, width)


if __name__ == "__main__":
    run_benchmark(main)
