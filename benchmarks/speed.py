"""Time and memory: whole runs as they grow and with each part, the rasterizers, a GPU, a
batch, the app.

python benchmarks/speed.py runs|rasterizers|gpu|combinations|batch|app --help
"""

import argparse
import itertools
import json
import math
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import psutil
import torch
from edit3r_select.by_segmenter import select_masks
from harness import run_benchmark
from PIL import Image

import edit3r
from edit3r.contract.interfaces import Rasterizer, Selection
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import intrinsics_from_fov, unproject
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.weights.find import at_hand

# ---- runs ----

PHOTOS, RUNS_SIZES, GAUSSIANS = (
    (2, 4, 6, 8),
    (128, 256, 512, 1024),
    (10_000, 100_000, 1_000_000),
)
AXES = {
    "photos": "photos of 256 pixels, the whole run and 12 frames",
    "pixels": "pixels of each of two photos, the same",
    "gaussians": "Gaussians drawn at 512 pixels, forward and backward",
}


def run_once(folder: str, photos: int, size: int) -> dict[str, float]:
    """Measure one run; the photos are enlarged where they are smaller than `size`."""
    import torch

    import edit3r
    from edit3r.contract.reporting import peak_memory_mb
    from edit3r.kit import asking
    from edit3r.kit.photos.posed_folder import read_posed_folder
    from edit3r.kit.rendering import path_around

    torch.set_num_threads(1)
    middle = len(cameras := read_posed_folder(folder).cameras) // 2
    files = [
        Path(folder) / camera.file
        for camera in cameras[middle - photos // 2 :][:photos]
    ]
    views = replace(edit3r.load_views(files, size=size), c2w=None)
    views = views.at(
        tuple(round(side * size / max(views.image_size)) for side in views.image_size)
    )
    # loads kernels
    edit3r.run(replace(edit3r.load_views(files[:2], size=96), c2w=None), editor="none")
    start = time.process_time()
    result = edit3r.run(views, editor="none")
    path = path_around(result.cameras, result.rendered, 12)
    with torch.no_grad():
        for frame in range(path.count):
            asking.render(result.rasterizer, result.gaussians, path.select([frame]))
    height, width = views.image_size
    return {
        "photos": photos,
        "pixels": height * width,
        "seconds": time.process_time() - start,
        "mb": peak_memory_mb(),
    }


def draw_once(count: int) -> dict[str, float]:
    """Draw a generated cloud forward and backward."""
    import torch

    import edit3r
    from edit3r.contract.reporting import peak_memory_mb
    from edit3r_testing.scenes import cameras_around, gaussian_cloud

    torch.set_num_threads(1)
    rasterizer = edit3r.build("rasterizer", "numba", threads=1)
    cloud = gaussian_cloud(count)
    cloud = replace(
        cloud,
        scales=cloud.scales * (1000 / count) ** 0.5,
        means=cloud.means.requires_grad_(True),
    )
    camera = cameras_around(1).at((512, 512))
    times = []
    for _ in range(3):
        start = time.process_time()
        rasterizer.render(cloud, camera).images.sum().backward()
        times.append(time.process_time() - start)
    return {"gaussians": count, "seconds": min(times), "mb": peak_memory_mb()}


def exponent(rows: list[dict[str, float]], axis: str, cost: str) -> float:
    return float(
        np.polyfit(
            np.log([row[axis] for row in rows]), np.log([row[cost] for row in rows]), 1
        )[0]
    )


def plot_of_runs(rows: list[dict[str, float]], axis: str, file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    figure, left = pyplot.subplots(figsize=(5, 3.4), layout="constrained")
    right = left.twinx()
    for side, cost, colour in (
        (left, "seconds", "tab:blue"),
        (right, "mb", "tab:orange"),
    ):
        side.loglog(
            [row[axis] for row in rows], [row[cost] for row in rows], "o-", color=colour
        )
        for scale in (side.xaxis, side.yaxis):  # plain numbers, few of them
            low, high = scale.get_data_interval()
            scale.set_major_locator(
                ticker.LogLocator(subs=(1,) if high > 100 * low else (1, 2, 5))
            )
            scale.set_major_formatter(ticker.EngFormatter(sep=""))
            scale.set_minor_locator(ticker.NullLocator())
        side.set_ylabel(
            f"{'processor seconds' if cost == 'seconds' else 'peak MiB'}", color=colour
        )
    left.set_xlabel(AXES[axis].partition(",")[0])
    left.set_title(
        f"time ~ n^{exponent(rows, axis, 'seconds'):.2f}, memory ~ "
        f"n^{exponent(rows, axis, 'mb'):.2f}"
    )
    figure.savefig(file, dpi=110)


def runs() -> None:
    """How time and memory of a run grow with photos, pixels and Gaussians: exponents and three
    plots.

        python benchmarks/speed.py runs FOLDER --out docs/images

    FOLDER holds photos with a cameras.json; photos that stand side by side are taken, their poses
    are not used. Every run is a process of its own, its figure the processor seconds from photos in
    memory to the last frame of a camera path of 12 frames (kernels loaded before), and the most
    memory the process ever held. The Gaussians of the third plot come from a generated cloud, drawn
    from one camera at 512 pixels, forward and backward. An exponent is the slope of a straight line
    through the logarithms: 1 is linear. `--photos`, `--sizes` and `--gaussians` narrow the range.
    """
    parser = argparse.ArgumentParser(
        description=runs.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--photos", type=int, nargs="*", default=PHOTOS)
    parser.add_argument("--sizes", type=int, nargs="*", default=RUNS_SIZES)
    parser.add_argument("--gaussians", type=int, nargs="*", default=GAUSSIANS)
    # the process of one figure
    parser.add_argument("--one", nargs="+", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        print(
            json.dumps(
                run_once(args.folder, *args.one)
                if len(args.one) == 2
                else draw_once(*args.one)
            )
        )
        return
    args.out.mkdir(parents=True, exist_ok=True)
    wanted = {
        "photos": [(count, 256) for count in args.photos],
        "pixels": [(2, size) for size in args.sizes],
        "gaussians": [(count,) for count in args.gaussians],
    }
    print(
        "| against | range | processor s | exponent | peak MiB | exponent |\n"
        "| --- | --- | --: | --: | --: | --: |"
    )
    for axis, several in wanted.items():
        rows = []
        for run in several:
            command = [sys.executable, __file__, "runs", args.folder, "--one"]
            command += map(str, run)
            printed = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
            rows.append(json.loads(printed.splitlines()[-1]))
        if len(rows) > 1:
            print(f"| {AXES[axis]} | {summary(rows, axis)} |", flush=True)
            plot_of_runs(rows, axis, args.out / f"growth_{axis}.png")


def summary(rows: list[dict[str, float]], axis: str) -> str:
    """Range, seconds, MiB and their exponents, as cells of a table."""
    low, high = rows[0], rows[-1]
    return " | ".join(
        [
            f"{low[axis]:,} to {high[axis]:,}",
            f"{low['seconds']:.2f} to {high['seconds']:.1f}",
            f"{exponent(rows, axis, 'seconds'):.2f}",
            f"{low['mb']:.0f} to {high['mb']:.0f}",
            f"{exponent(rows, axis, 'mb'):.2f}",
        ]
    )


# ---- rasterizers ----

FIELDS = ("means", "scales", "quats", "opacities", "harmonics")
COUNTS = (1_000, 10_000, 131_072, 1_000_000, 4_000_000)
RASTERIZERS_SIZES = (128, 256, 512, 1024)


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
        (131_072, size) for size in RASTERIZERS_SIZES if size != 256
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


def plot_of_rasterizers(timings: list[Timing], path: Path) -> None:
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
        xticks=RASTERIZERS_SIZES,
        xticklabels=RASTERIZERS_SIZES,
    )
    panels[1].minorticks_off()
    for panel in panels:
        panel.grid(True, which="major", alpha=0.3)
    panels[1].legend(loc="center left")
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def rasterizers() -> None:
    """Milliseconds per frame of the CPU rasterizers on pixel-aligned Gaussians, and how they grow.

        # the table: 131,072 Gaussians, 256x256 and 512x512
        python benchmarks/speed.py rasterizers
        # also 1e3 to 4e6 Gaussians, 128x128 to 1024x1024, with a plot
        python benchmarks/speed.py rasterizers --growth
        # gradients for the camera too
        python benchmarks/speed.py rasterizers --cameras
        python benchmarks/speed.py rasterizers --growth --torch-seconds 600 --out docs/images

    The scene is what a feed-forward reconstructor makes: one Gaussian per pixel of two square views
    of a wavy wall, 1 to 2 pixels across (twice the standard deviation), opacities 0.2 to 1, plain
    colours. Times are wall milliseconds, minimum and median of the repetitions; CPU milliseconds of
    the rendering thread tell how much of the wall time another job took (only with one thread).
    Needs matplotlib for the plot.
    """
    parser = argparse.ArgumentParser(description=rasterizers.__doc__.split("\n")[0])
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
    plot_of_rasterizers(timings, options.out / "rasterizer-growth.png")


# ---- gpu ----

PRECISIONS = {
    "float32": {"precision": "float32"},
    "bfloat16, heads float32": {"precision": "bfloat16", "head_precision": "float32"},
    "bfloat16": {"precision": "bfloat16"},
}


def gpu(*, network: bool = False) -> Iterator[dict]:
    """What a CUDA GPU gains: frames by gsplat and by numba on the same machine's CPU and how far
    they agree, and one pass of the NoPoSplat network in each precision.

        python benchmarks/speed.py gpu
        python benchmarks/speed.py gpu --network

    Seconds are the wall's, the least of five after one that is not counted. The scene is that of
    `rasterizers`, the network has random weights: its errors are those of arithmetic.
    """
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


# ---- combinations ----

RESULTS = Path(__file__).with_name("combinations.json")
MASK = Path(edit3r.__file__).parent / "kit/photos/motorcycle_mask.png"
COMBINED_SIZE = 256
ASKED = {
    "none": [],
    "recolor": ["--prompt", "paint the motorcycle blue"],
    "looks": ["--prompt", "make it look like autumn"],
    "mock-diffusion": ["--prompt", "make it rusty"],
    "retouch": ["--mask", str(MASK)],
}
MATCHERS = {"classical (matches=learned)": "{name: classical, matches: learned}"}
CLICK = (0.45, 0.55)


def run_combined(editor: str, recon: str, matcher: str = "classical") -> dict:
    """One run by the command, in a process of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    row = {"editor": editor, "recon": recon, "matcher": matcher}
    chosen = ["--set", f"matcher={MATCHERS[matcher]}"] if matcher in MATCHERS else []
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "edit3r",
            "run",
            "--editor",
            editor,
            "--recon",
            recon,
            "--size",
            str(COMBINED_SIZE),
        ]
        command += [
            *ASKED[editor],
            *chosen,
            "--frames",
            "2",
            "--outputs",
            "sheet",
            "--quiet",
            "--out",
            folder + "/out",
        ]
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, check=False
        )
        if done.returncode:
            return {**row, "error": done.stderr.strip().splitlines()[-1]}
        made = json.loads(Path(folder, "out", "run.json").read_text())
    seconds = {stage["name"]: stage["cpu_seconds"] for stage in made["stages"]}
    edit = sum(value for name, value in seconds.items() if name.startswith("edit"))
    rest = sum(seconds.values()) - edit
    peak = max(stage["peak_memory_mb"] for stage in made["stages"])
    return {
        **row,
        "edit": round(edit, 1),
        "rest": round(rest, 1),
        "mb": round(peak),
        "verdict": made["verdict"]["label"],
    }


def segment(name: str) -> dict:
    """Masks of both photos from one click."""
    views = edit3r.load_views(packaged_pair()[0], size=COMBINED_SIZE)
    segmenter = edit3r.build("segmenter", name)
    start = time.process_time()
    with torch.no_grad():
        select_masks(views.images[0], Selection(positive=((0, *CLICK),)), segmenter)
    return {"segmenter": name, "seconds": round(time.process_time() - start, 1)}


def combinations() -> None:
    """What each combination of editor, reconstructor, matcher and segmenter costs that needs no
    weights from elsewhere.

        # editors x classical, edit3r; matchers; segmenter
        python benchmarks/speed.py combinations
        # and single ones, added to those before
        python benchmarks/speed.py combinations --editors looks --recons refit

    Every run is `edit3r run` on the packaged pair at 256 pixels, in a process of its own on one
    thread. Results go into `benchmarks/combinations.json`, from which `python docs/generate.py`
    makes the tables of docs/combinations.md: CPU seconds of the edit and of all else, peak memory
    of the process, the run's verdict, or the sentence that it ended with. Weights that are at hand
    are used and noted.
    """
    parser = argparse.ArgumentParser(
        description=combinations.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--editors", nargs="+")
    parser.add_argument("--recons", nargs="+")
    options = parser.parse_args()
    made = [
        run_combined(e, r)
        for e in options.editors or ASKED
        for r in options.recons or ("classical", "edit3r")
    ]
    if not (options.editors or options.recons):
        made += [
            run_combined("none", recon, matcher)
            for matcher in MATCHERS
            for recon in ("classical", "edit3r")
        ]
        made.append(segment("grabcut"))
    rows = json.loads(RESULTS.read_text())["rows"] if RESULTS.exists() else []
    keys = ("editor", "recon", "matcher", "segmenter")
    kept = {tuple(row.get(key) for key in keys): row for row in [*rows, *made]}
    components = [offer.component for kind in ("editor", "reconstructor", "segmenter", "matcher")
                  for offer in edit3r.components(kind)]  # fmt: skip
    real = sorted(
        {
            one.name
            for component in components
            for one in component.weights
            if at_hand(one)
        }
    )
    result = {
        "size": COMBINED_SIZE,
        "weights_at_hand": real,
        "rows": list(kept.values()),
    }
    RESULTS.write_text(json.dumps(result, indent=1) + "\n")
    for row in made:
        print(row)


# ---- batch ----

COLOURS = ("red", "blue", "green", "yellow", "orange", "purple", "pink", "teal")
PROGRAM = [sys.executable, "-m", "edit3r"]


def make_jobs(folder: Path, count: int, size: int, frames: int) -> list[dict]:
    jobs = []
    for number in range(count):
        left, top = 20 * (number % 6), 12 * (number // 6 % 5)
        photos = [f"{number:03d}-{side}.png" for side in ("left", "right")]
        for name, file in zip(photos, packaged_pair()[0]):
            picture = Image.open(file)
            box = (left, top, left + picture.width - 100, top + picture.height - 60)
            picture.crop(box).resize(
                (size, size * (box[3] - box[1]) // (box[2] - box[0]))
            ).save(folder / name)
        instruction = {
            "prompt": f"paint it {COLOURS[number % 8]}",
            "size": size,
            "frames": frames,
            "fov": 50,
        }
        jobs.append({"id": f"scene-{number:03d}", "photos": photos, **instruction})
    (folder / "jobs.jsonl").write_text(
        "".join(json.dumps(job) + "\n" for job in jobs), encoding="utf-8"
    )
    return jobs


def command(folder: Path, job: dict) -> None:
    options = [
        "--prompt",
        job["prompt"],
        "--size",
        str(job["size"]),
        "--fov",
        "50",
    ]
    options += ["--frames", str(job["frames"])]
    photos = [str(folder / name) for name in job["photos"]]
    out = str(folder / "single" / job["id"])
    subprocess.run(
        [*PROGRAM, "run", *photos, *options, "--quiet", "--out", out], check=True
    )


def spent_by(act) -> tuple[float, float]:
    """Processor and wall seconds of what `act` starts."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    act()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (
        after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        time.perf_counter() - start,
    )


def batch() -> None:
    """What small scenes cost as a batch and as single commands: half of the commands, the batch,
    the other half.

        python benchmarks/speed.py batch DIR --jobs 40 --commands 12 --workers 2

    The scenes are crops of the packaged pair, each with a colour of its own. Processor seconds of
    all processes and wall seconds for each scene; commands run as many at a time as the batch has
    workers, each with one thread.
    """
    parser = argparse.ArgumentParser(
        description=batch.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="an empty folder")
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--commands", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--frames", type=int, default=4)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    os.environ.update({"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"})
    jobs = make_jobs(args.folder, args.jobs, args.size, args.frames)
    command(args.folder, jobs[0])  # compiles what this machine has not compiled yet

    def commands(chosen: list[dict]) -> None:
        with ThreadPoolExecutor(args.workers) as pool:
            list(pool.map(lambda job: command(args.folder, job), chosen))

    def together() -> None:
        options = [
            "--out",
            str(args.folder / "batch"),
            "--workers",
            str(args.workers),
            "--quiet",
        ]
        subprocess.run(
            [*PROGRAM, "batch", str(args.folder / "jobs.jsonl"), *options], check=True
        )

    half = args.commands // 2
    first = spent_by(lambda: commands(jobs[:half]))
    whole = spent_by(together)
    second = spent_by(lambda: commands(jobs[half : args.commands]))
    singles = [(a + b) / args.commands for a, b in zip(first, second)]
    batched = [seconds / args.jobs for seconds in whole]
    runs = [
        json.loads(path.read_text())
        for path in (args.folder / "batch").glob("*/run.json")
    ]
    cpu = sorted(sum(stage["cpu_seconds"] for stage in run["stages"]) for run in runs)
    peak = max(stage["peak_memory_mb"] for run in runs for stage in run["stages"])
    size = sum(
        path.stat().st_size for path in (args.folder / "batch").glob("scene-*/**/*")
    ) / len(runs)
    print(
        f"stages {cpu[0]:.2f} to {cpu[-1]:.2f} processor s, median {cpu[len(cpu) // 2]:.2f}"
    )
    print(f"a worker takes up to {peak:.0f} MB of memory, a folder {size / 1e6:.1f} MB")
    for name, single, one in zip(("processor", "wall"), singles, batched):
        print(
            f"{name}: a command {single:.2f} s, a job of the batch {one:.2f} s: "
            f"{single / one:.2f} times as many"
        )


# ---- app ----

PATIENCE = 300_000  # [ms]
ALL = "in all"
TANK = 0.55, 0.4  # of the motorcycle, in shares of the photo


class Watch:
    """Seconds since the step before, of the clock and of processes that may have ended."""

    def __init__(self) -> None:
        self.spent: dict[int, tuple[str, float]] = {}
        threading.Thread(target=self._follow, daemon=True).start()
        self.begun = self.last = time.perf_counter()
        self.before = self.first = self.processor()

    def _follow(self) -> None:
        while True:  # what a process used is known as long as it lives
            self.processor()
            time.sleep(0.2)

    def processor(self) -> tuple[float, float]:
        """In the app and in the browser, [s]."""
        for one in psutil.Process(os.getpid()).children(recursive=True):
            try:
                used = one.cpu_times()
                kind = "browser" if "chrom" in one.name() else "app"
                self.spent[one.pid] = (kind, used.user + used.system)
            except psutil.Error:
                continue
        spent = list(self.spent.values())
        return tuple(
            sum(used for kind, used in spent if kind == wanted)
            for wanted in ("app", "browser")
        )

    def step(self, name: str) -> None:
        now, used = time.perf_counter(), self.processor()
        begun, before = (
            (self.begun, self.first) if name == ALL else (self.last, self.before)
        )
        app, browser = (a - b for a, b in zip(used, before))
        print(
            f"{name:28s} {now - begun:6.1f} s   CPU {app:5.1f} s   browser {browser:5.1f} s",
            flush=True,
        )
        self.last, self.before = now, used


def app() -> None:
    """The way of a person through the app: drop two photos, point, say, see, compare, download.

        python benchmarks/speed.py app [--size 384] [--phone]

    The packaged pair in headless Chromium that draws by software, networks not yet loaded. For each
    step the seconds of the clock, and of the processor in the app and its runs and in the browser.
    Needs playwright and Chromium, as the tests of the app do.
    """
    sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
    from playwright.sync_api import sync_playwright
    from screens import SOFTWARE_GL, app as serve

    parser = argparse.ArgumentParser(
        description=app.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=384, help="of the photos [pixels]")
    parser.add_argument("--phone", action="store_true", help="at 390 x 844")
    args = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as place,
        serve(Path(place) / "jobs", args.size) as address,
        sync_playwright() as driver,
    ):
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=SOFTWARE_GL
        )
        page = browser.new_page(accept_downloads=True)
        page.set_default_timeout(PATIENCE)
        size = (390, 844) if args.phone else (1280, 800)
        page.set_viewport_size(dict(zip(("width", "height"), size)))
        page.goto(address)
        page.locator(".try img").last.wait_for()
        watch = Watch()
        with page.expect_file_chooser() as choosing:
            page.get_by_text("Choose photos").click()
        choosing.value.set_files(packaged_pair()[0])
        page.wait_for_function("document.querySelector('.box .base')?.naturalWidth > 0")
        watch.step("drop")
        box = page.locator(".box").bounding_box()
        page.locator(".box").click(
            position={"x": TANK[0] * box["width"], "y": TANK[1] * box["height"]}
        )
        page.wait_for_function("document.body.dataset.outlined")
        watch.step("point, until the outline")
        page.get_by_label("what to change").fill("paint it golden")
        page.locator(".line", has_text="edit: ").wait_for()
        watch.step("say, until the verdict")
        page.get_by_role("button", name="Go", exact=True).click()
        page.locator(".stage iframe").wait_for()
        watch.step("see: the run")
        viewer = page.frame_locator(".stage iframe")
        viewer.locator("body[data-drawn]").wait_for()
        watch.step("see: the scene drawn")
        viewer.locator("#cut").press("ArrowLeft")
        watch.step("compare")
        page.get_by_role("button", name="download").click()
        file = page.locator(".file", has_text="viewer.html")
        file.get_by_text(" kB").wait_for()
        with page.expect_download() as loading:
            file.press("Enter")
        loading.value.path()
        watch.step("download")
        watch.step(ALL)


if __name__ == "__main__":
    run_benchmark(runs, rasterizers, gpu, combinations, batch, app)
