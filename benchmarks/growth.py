"""How time and memory of a run grow with photos, pixels and Gaussians: exponents and three plots.

    python benchmarks/growth.py FOLDER --out docs/images

FOLDER holds photos with a cameras.json; photos that stand side by side are taken, their poses are
not used. Every run is a process of its own, its figure the processor seconds from photos in memory
to the last frame of a camera path of 12 frames (kernels loaded before), and the most memory the
process ever held. The Gaussians of the third plot come from a generated cloud, drawn from one
camera at 512 pixels, forward and backward. An exponent is the slope of a straight line through the
logarithms: 1 is linear. `--photos`, `--sizes` and `--gaussians` narrow the range.
"""

import argparse
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

PHOTOS, SIZES, GAUSSIANS = (
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
    from edit3r.kit.photos.posed_folder import read_posed_folder
    from edit3r.kit.rendering import path_around, render_one

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
            render_one(result.rasterizer, result.gaussians, path.select([frame]))
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


def plot(rows: list[dict[str, float]], axis: str, file: Path) -> None:
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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--photos", type=int, nargs="*", default=PHOTOS)
    parser.add_argument("--sizes", type=int, nargs="*", default=SIZES)
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
    for axis, runs in wanted.items():
        rows = []
        for run in runs:
            command = [sys.executable, __file__, args.folder, "--one", *map(str, run)]
            printed = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
            rows.append(json.loads(printed.splitlines()[-1]))
        if len(rows) > 1:
            print(f"| {AXES[axis]} | {summary(rows, axis)} |", flush=True)
            plot(rows, axis, args.out / f"growth_{axis}.png")


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


if __name__ == "__main__":
    main()
