"""What a CUDA GPU gains: frames by gsplat and by numba on the same machine's CPU and how far they
agree, and one pass of the NoPoSplat network in each precision.

    python benchmarks/gpu.py
    python benchmarks/gpu.py --network

Seconds are the wall's, the least of five after one that is not counted. The scene is that of
rasterizers.py, the network has random weights: its errors are those of arithmetic.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import torch
from harness import run_benchmark
from rasterizers import FIELDS, front_camera, pixel_aligned

import edit3r
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.cameras import intrinsics_from_fov

PRECISIONS = {
    "float32": {"precision": "float32"},
    "bfloat16, heads float32": {"precision": "bfloat16", "head_precision": "float32"},
    "bfloat16": {"precision": "bfloat16"},
}


def main(*, network: bool = False) -> Iterator[dict]:
    """Frames of both rasterizers, or with `network` its passes."""
    print(torch.cuda.get_device_name(), "torch", torch.__version__)
    if network:
        for views, tf32 in itertools.product((2, 4), (False, True)):
            yield from passes(views, tf32)
        return
    print(agreement())
    for count, size in itertools.product((10_000, 131_072, 1_000_000), (256, 512)):
        for name, device in (("numba", "cpu"), ("gsplat", "cuda")):
            yield frame(name, device, count, size)


def agreement() -> str:
    """Largest difference of a picture of gsplat from one of numba, and of gradients, relative."""
    pictures, gradients = {}, {}
    for name, device in (("numba", "cpu"), ("gsplat", "cuda")):
        scene = _asking(pixel_aligned(20_000).to(device))
        cameras = front_camera(256).to(device)
        shown = edit3r.build("rasterizer", name).render(scene, cameras).images
        shown.square().sum().backward()
        pictures[name] = shown.detach().cpu()
        gradients[name] = {field: getattr(scene, field).grad.cpu() for field in FIELDS}
    apart = float((pictures["gsplat"] - pictures["numba"]).abs().max())
    off = (_relative(gradients["gsplat"][f], gradients["numba"][f]) for f in FIELDS)
    return f"apart: pictures {apart:.1e}, gradients {max(off):.1e}"


def frame(name: str, device: str, count: int, size: int) -> dict:
    """Milliseconds of one frame, and of one with gradients for everything."""
    rasterizer = edit3r.build("rasterizer", name)
    scene = pixel_aligned(count).to(device)
    cameras = front_camera(size).to(device)
    asking = _asking(scene)
    with torch.no_grad():
        drawn = _least(lambda: rasterizer.render(scene, cameras))
    learned = _least(
        lambda: rasterizer.render(asking, cameras).images.square().sum().backward()
    )
    return {
        "rasterizer": name,
        "Gaussians": f"{count:,}",
        "pixels": str(size),
        "ms": (1e3 * drawn, ".1f"),
        "with gradients": (1e3 * learned, ".1f"),
    }


def passes(views: int, tf32: bool) -> Iterator[dict]:
    """One pass in each precision: milliseconds, memory, distance from plain float32."""
    draw = torch.Generator().manual_seed(0)
    images = torch.rand(1, views, 3, 256, 256, generator=draw).cuda()
    lens = intrinsics_from_fov(1.0, (256, 256)).repeat(1, views, 1, 1).cuda()
    _allow_tf32(False)
    truth = _pass(PRECISIONS["float32"], images, lens)()
    _allow_tf32(tf32)
    for name, precision in PRECISIONS.items():
        run = _pass(precision, images, lens)
        torch.cuda.reset_peak_memory_stats()
        seconds, found = _least(run), run()
        off = max(_relative(getattr(found, f), getattr(truth, f)) for f in FIELDS)
        yield {
            "views": str(views),
            "precision": f"{name}, tf32" if tf32 else name,
            "ms": (1e3 * seconds, ".1f"),
            "MiB": (torch.cuda.max_memory_allocated() / 2**20, ".0f"),
            "apart": (off, ".0e"),
        }


def _pass(precision: dict, images, lens) -> Callable[[], Gaussians]:
    made = edit3r.build(
        "reconstructor", "noposplat", weights="random", device="cuda", **precision
    )

    def run() -> Gaussians:
        with torch.no_grad():
            return made.network(images, lens)

    return run


def _allow_tf32(allowed: bool) -> None:
    torch.backends.cuda.matmul.allow_tf32 = allowed
    torch.backends.cudnn.allow_tf32 = allowed


def _asking(scene: Gaussians) -> Gaussians:
    """The scene with leaves that ask for gradients."""
    leaves = {f: getattr(scene, f).clone().requires_grad_(True) for f in FIELDS}
    return replace(scene, **leaves)


def _least(run: Callable[[], object], repeats: int = 5) -> float:
    taken = []
    for _ in range(repeats + 1):
        torch.cuda.synchronize()
        started = time.perf_counter()
        run()
        torch.cuda.synchronize()
        taken.append(time.perf_counter() - started)
    return min(taken[1:])


def _relative(found, expected) -> float:
    return float((found.double() - expected.double()).norm() / expected.double().norm())


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.0e}" for name, value in values.items())


if __name__ == "__main__":
    run_benchmark(main)
