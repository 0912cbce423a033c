"""Milliseconds per frame of the CPU rasterizers on pixel-aligned Gaussians, and how they grow.

    # the table: 131,072 Gaussians, 256x256 and 512x512
    python benchmarks/rasterizers.py
    # also 1e3 to 4e6 Gaussians, 128x128 to 1024x1024, with a plot
    python benchmarks/rasterizers.py --growth
    # gradients for the camera too
    python benchmarks/rasterizers.py --cameras
    python benchmarks/rasterizers.py --growth --torch-seconds 600 --out docs/images

The scene is what a feed-forward reconstructor makes: one Gaussian per pixel of two square views of
a wavy wall, 1 to 2 pixels across (twice the standard deviation), opacities 0.2 to 1, plain colours.
Times are wall milliseconds, minimum and median of the repetitions; CPU milliseconds of the
rendering thread tell how much of the wall time another job took (only with one thread). Needs
matplotlib for the plot.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

import edit3r
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import intrinsics_from_fov, unproject

FIELDS = ("means", "scales", "quats", "opacities", "harmonics")
COUNTS = (1_000, 10_000, 131_072, 1_000_000, 4_000_000)
SIZES = (128, 256, 512, 1024)


@dataclass(frozen=True)
class Timing:
    """One measured configuration."""

    rasterizer: str
    threads: int
    gaussians: int
    size: int  # [pixels]
    backward: bool
    minimum: float  # wall [ms]
    median: float  # wall [ms]
    cpu: float  # least CPU time of the calling thread [ms]
    repetitions: int


def pixel_aligned(count: int, seed: int = 0) -> Gaussians:
    """About `count` Gaussians, one per pixel of two square views; exactly 131,072 for views of
    256x256.
    """
    side = max(2, round(math.sqrt(count / 2)))
    draw = torch.Generator().manual_seed(seed)
    return Gaussians.cat([_view(view, side, draw) for view in range(2)])


def _view(view: int, side: int, draw: torch.Generator) -> Gaussians:
    intrinsics, c2w = intrinsics_from_fov(1.0, (side, side)), torch.eye(4)
    angle = 0.1 * view
    c2w[0, 0] = c2w[2, 2] = math.cos(angle)
    c2w[2, 0], c2w[0, 2], c2w[0, 3] = math.sin(angle), -math.sin(angle), 0.3 * view
    line = torch.linspace(0, 1, side)
    y, x = torch.meshgrid(line, line, indexing="ij")
    depths = (
        3
        + 0.6 * torch.sin(5 * x + view) * torch.cos(4 * y)
        + 0.01 * torch.rand(side, side, generator=draw)
    )
    means = unproject(depths[None], intrinsics[None], c2w[None]).reshape(1, -1, 3)
    # width of a pixel at that depth [scene units]
    pixel = depths.reshape(1, -1, 1) / (intrinsics[0, 0] * side)
    total = side * side
    return Gaussians(
        means,
        pixel * (0.5 + 0.5 * torch.rand(1, total, 3, generator=draw)),
        torch.randn(1, total, 4, generator=draw),
        0.2 + 0.8 * torch.rand(1, total, generator=draw),
        0.6 * torch.randn(1, total, 1, 3, generator=draw),
    )


def front_camera(size: int) -> Cameras:
    return Cameras(
        torch.eye(4)[None, None],
        intrinsics_from_fov(1.0, (size, size))[None, None],
        (size, size),
    )


def measure(
    name: str,
    rasterizer: Rasterizer,
    threads: int,
    count: int,
    size: int,
    backward: bool,
    budget: float,
    cameras: bool = False,
):
    """Time one configuration: one run to warm up, then 20, or fewer for one that takes longer than
    `budget` [s]. With `cameras`, the camera asks for gradients too.
    """
    torch.set_num_threads(threads)
    scene, camera = pixel_aligned(count), front_camera(size)
    camera.c2w.requires_grad_(cameras and backward)
    camera.intrinsics.requires_grad_(cameras and backward)
    frame = _frame(rasterizer, scene, camera, backward)
    frame()
    walls, cpus, began = [], [], time.perf_counter()
    while len(walls) < 20 and (not walls or time.perf_counter() - began < budget):
        wall, cpu = time.perf_counter(), time.thread_time()
        frame()
        walls.append(1e3 * (time.perf_counter() - wall))
        cpus.append(1e3 * (time.thread_time() - cpu))
    median = sorted(walls)[len(walls) // 2]
    return Timing(
        name,
        threads,
        scene.count,
        size,
        backward,
        min(walls),
        median,
        min(cpus),
        len(walls),
    )


def _frame(
    rasterizer: Rasterizer, scene: Gaussians, camera: Cameras, backward: bool
) -> Callable[[], None]:
    if not backward:
        return lambda: rasterizer.render(scene, camera)
    leaves = [getattr(scene, name).clone().requires_grad_() for name in FIELDS]
    weights = torch.randn(
        1, 1, 3, *camera.image_size, generator=torch.Generator().manual_seed(1)
    )

    def frame() -> None:
        for leaf in leaves:
            leaf.grad = None
        rasterizer.render(Gaussians(*leaves), camera).images.backward(weights)

    return frame


def table(
    threads: tuple[int, ...], torch_seconds: float, cameras: bool
) -> Iterator[Timing]:
    """The headline: 131,072 Gaussians at 256x256 and 512x512."""
    for size in (256, 512):
        for backward in (False, True):
            for number in threads:
                yield measure(
                    "numba",
                    edit3r.build("rasterizer", "numba"),
                    number,
                    131_072,
                    size,
                    backward,
                    1e9,
                    cameras,
                )
            if torch_seconds:
                reference = edit3r.build("rasterizer", "torch")
                yield measure(
                    "torch",
                    reference,
                    threads[0],
                    131_072,
                    size,
                    backward,
                    torch_seconds,
                    cameras,
                )


def growth(torch_seconds: float) -> Iterator[Timing]:
    """From few to many Gaussians at 256x256, and from small to large pictures with 131,072
    Gaussians; one thread.
    """
    cases = [(count, 256) for count in COUNTS] + [
        (131_072, size) for size in SIZES if size != 256
    ]
    for count, size in cases:
        for backward in (False, True):
            yield measure(
                "numba",
                edit3r.build("rasterizer", "numba"),
                1,
                count,
                size,
                backward,
                60,
            )
        if torch_seconds and count <= 131_072:
            yield measure(
                "torch",
                edit3r.build("rasterizer", "torch"),
                1,
                count,
                size,
                False,
                torch_seconds,
            )


def print_row(timing: Timing) -> None:
    what = "forward+backward" if timing.backward else "forward"
    print(
        f"| {timing.rasterizer} | {timing.threads} | {timing.gaussians:,} | {timing.size} | {what} "
        f"| {timing.minimum:.1f} | {timing.median:.1f} | {timing.cpu:.1f} | {timing.repetitions} |",
        flush=True,
    )


def plot(timings: list[Timing], path: Path) -> None:
    """Two panels of least CPU times: by number of Gaussians at 256x256, by picture size with
    131,072.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 2, figsize=(10, 4), sharey=True)
    lines = (
        ("numba", False, "#1b6ca8"),
        ("numba", True, "#e07b39"),
        ("torch", False, "#777777"),
    )
    for name, backward, colour in lines:
        own = [t for t in timings if (t.rasterizer, t.backward) == (name, backward)]
        label = f"{name}, forward{' + backward' if backward else ''}"
        by_count = sorted((t.gaussians, t.cpu) for t in own if t.size == 256)
        by_size = sorted((t.size, t.cpu) for t in own if t.gaussians == 131_072)
        for panel, points in zip(panels, (by_count, by_size)):
            if points:
                panel.plot(*zip(*points), "o-", color=colour, label=label)
    panels[0].set(
        xscale="log",
        yscale="log",
        xlabel="Gaussians (256 x 256 pixels)",
        ylabel="CPU ms per frame, one thread, minimum",
    )
    panels[1].set(
        xscale="log",
        xlabel="picture side [pixels] (131,072 Gaussians)",
        xticks=SIZES,
        xticklabels=SIZES,
    )
    panels[1].minorticks_off()
    for panel in panels:
        panel.grid(True, which="major", alpha=0.3)
    panels[1].legend(loc="center left")
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--growth", action="store_true", help="also measure and plot the growth"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("."),
        help="folder for rasterizer-growth.png and its figures",
    )
    parser.add_argument(
        "--torch-seconds",
        type=float,
        default=20,
        help="per configuration of the reference; 0: skip it",
    )
    parser.add_argument(
        "--cameras", action="store_true", help="gradients for the camera too"
    )
    options = parser.parse_args()
    every = torch.get_num_threads()
    print(
        "| rasterizer | threads | Gaussians | size | what | min ms | median ms | CPU ms | "
        "repetitions |"
    )
    print("| --- | --: | --: | --: | --- | --: | --: | --: | --: |")
    threads = (1,) if every == 1 else (1, every)
    for timing in table(threads, options.torch_seconds, options.cameras):
        print_row(timing)
    if not options.growth:
        return
    timings = []
    for timing in growth(options.torch_seconds):
        print_row(timing)
        timings.append(timing)
    options.out.mkdir(parents=True, exist_ok=True)
    figures = json.dumps([asdict(t) for t in timings], indent=1)
    (options.out / "rasterizer-growth.json").write_text(figures + "\n")
    plot(timings, options.out / "rasterizer-growth.png")


if __name__ == "__main__":
    main()
