"""Gradients for cameras: how exact, what they cost, and how fast a camera is aligned with them.

    OMP_NUM_THREADS=1 python benchmarks/camera_gradients.py

Prints three tables: errors against the reference in float64 on the scenes of
`test_camera_gradients.py`, processor time of the backward pass alone, without and with a camera
that asks, and processor time and result of `edit3r_measure.protocol.align`.
"""

import math
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
import torch.nn.functional as F
from edit3r_measure.protocol import align
from rasterizers import front_camera, pixel_aligned

import edit3r
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.rotations import cross_matrix

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "plugins" / "edit3r_rasterizers"))

from raster_scenes import FIELDS, gradients  # noqa: E402
from test_camera_gradients import GREY, NUMBA, SCENES, TORCH  # noqa: E402

CAMERAS = ("c2w", "intrinsics")


def errors() -> None:
    """Largest error of each array, of the largest number in it."""
    print("| scene | numba c2w | intrinsics | torch in float32 c2w | intrinsics |")
    for name, (scene, views) in SCENES.items():
        exact = scene.to(torch.float64), views.to(torch.float64)
        truth = gradients(TORCH, *exact, GREY)
        cells = []
        for rasterizer in (NUMBA, TORCH):
            found = gradients(rasterizer, scene, views, GREY)
            for camera in CAMERAS:
                off = (found[camera] - truth[camera]).abs().max()
                cells.append(f"{off / truth[camera].abs().max():.1e}")
        print("|", " | ".join([name, *cells]), "|", flush=True)


def with_degree(degree: int) -> Gaussians:
    """The scene of `rasterizers.py` in smooth colours, with small harmonics above degree 0."""
    scene = pixel_aligned(131_072)
    x, y, _ = scene.means.unbind(-1)
    plain = torch.stack(
        (torch.sin(6 * x), torch.cos(7 * y), torch.sin(5 * x + 4 * y)), -1
    )
    draw = torch.Generator().manual_seed(0)
    count = (degree + 1) ** 2 - 1
    others = 0.3 * torch.randn(1, scene.count, count, 3, generator=draw)
    parts = {name: getattr(scene, name) for name in FIELDS}
    return Gaussians(**parts | {"harmonics": torch.cat((plain[:, :, None], others), 2)})


def backward_times() -> None:
    print("| size | degree | camera asks | least ms | median ms |")
    for size, degree in ((256, 0), (512, 0), (256, 1)):
        frames = {asks: _backward(with_degree(degree), size, asks) for asks in (0, 1)}
        times = {asks: [] for asks in frames}
        for _ in range(50):
            for asks, frame in frames.items():
                times[asks].append(frame())
        for asks, own in times.items():
            own = sorted(own[1:])  # the first one compiles
            middle = own[len(own) // 2]
            print(
                f"| {size} | {degree} | {bool(asks)} | {own[0]:.1f} | {middle:.1f} |",
                flush=True,
            )


def _backward(scene: Gaussians, size: int, camera_asks: int):
    """A function that draws and differentiates, and returns the latter's processor time [ms]."""
    rasterizer = edit3r.build("rasterizer", "numba", threads=1)
    leaves = [getattr(scene, name).clone().requires_grad_() for name in FIELDS]
    camera = front_camera(size)
    camera.c2w.requires_grad_(bool(camera_asks))
    camera.intrinsics.requires_grad_(bool(camera_asks))
    weights = torch.ones(1, 1, 3, size, size)

    def frame() -> float:
        for leaf in leaves:
            leaf.grad = None
        images = rasterizer.render(Gaussians(*leaves), camera).images
        began = time.thread_time()
        images.backward(weights)
        return 1e3 * (time.thread_time() - began)

    return frame


def alignment(starts: int = 4) -> None:
    print("| degree | s for 60 steps | degrees off | units off | squared error |")
    true, rasterizer = front_camera(256), edit3r.build("rasterizer", "numba")
    pose = np.eye(4)
    pose[0, 3] = 1
    for degree in (0, 2):
        scene = with_degree(degree)
        photo = rasterizer.render(scene, true).images
        predicted = SimpleNamespace(
            reconstruction=SimpleNamespace(gaussians=scene),
            rasterizer=rasterizer,
            predicted_pose=pose,
        )
        rows = []
        for seed in range(starts):
            began = time.process_time()
            start = _beside(true, seed)
            found = align(predicted, start, photo, F.mse_loss, 60)
            spent = time.process_time() - began
            c2w = found.c2w[0, 0].double()
            turn = math.degrees((c2w[:3, :3] - torch.eye(3)).norm() / 2**0.5)
            error = F.mse_loss(rasterizer.render(scene, found).images, photo)
            rows.append((spent, turn, c2w[:3, 3].norm().item(), error.item()))
        mean = np.mean(rows, 0)
        print("| {} | {:.1f} | {:.3f} | {:.4f} | {:.2e} |".format(degree, *mean))


def _beside(camera: Cameras, seed: int) -> Cameras:
    """A camera about a degree and 0.03 units off."""
    draw = torch.Generator().manual_seed(seed)
    turn, shift = torch.randn(2, 3, generator=draw) * torch.tensor([[0.015], [0.02]])
    rates = F.pad(torch.cat((cross_matrix(turn), shift[:, None]), 1), (0, 0, 0, 1))
    c2w = torch.linalg.matrix_exp(rates)[None, None]
    return Cameras(c2w, camera.intrinsics, camera.image_size)


if __name__ == "__main__":
    errors()
    backward_times()
    with torch.no_grad():
        alignment()
