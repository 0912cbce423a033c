"""Fewer Gaussians against picture quality: merging, opacity pruning and random dropping at equal count.

    python benchmarks/simplify.py FOLDER... --pairs 3 --size 256 --out DIR

Each FOLDER holds photos of one scene with their cameras. Two photos are reconstructed; the scene with all its
Gaussians, with those that `simplify` leaves, and with as many left by each rival, is compared with the real photo
between them. Writes `points.jsonl` (one line per scene, method and share), `curves.png`, and prints the means.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

import edit3r
from edit3r.errors import MatchingError
from edit3r.evaluation.metrics import psnr, ssim
from edit3r.evaluation.novel_view import relative_pose, views_of
from edit3r.evaluation.pairs import choose_triples
from edit3r.evaluation.posed_folder import Photo, read_posed_folder
from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.refine import refine
from edit3r.simplify import simplify
from edit3r.types import Cameras, Gaussians, Reconstruction

SHARES = (0.05, 0.1, 0.2, 0.33, 0.5)
REFINE_STEPS = 30
RENDER_REPEATS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", metavar="FOLDER")
    parser.add_argument("--recon", default="classical")
    parser.add_argument("--pairs", type=int, default=3, help="pairs per folder")
    parser.add_argument("--size", type=int, default=256, help="side of the square pictures [pixels]")
    parser.add_argument(
        "--shares", type=float, nargs="*", default=SHARES, help="shares of the Gaussians for the curves"
    )
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    recon, rasterizer = edit3r.build("reconstructor", args.recon), edit3r.build("rasterizer", "numba", threads=1)
    rows: list[dict] = []
    with (args.out / "points.jsonl").open("w") as file:
        for row in measure(args, recon, rasterizer):
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
    print(table(rows))
    plot(rows, args.out / "curves.png")


def measure(args: argparse.Namespace, recon: Reconstructor, rasterizer: Rasterizer) -> Iterator[dict]:
    for name in args.folders:
        folder = read_posed_folder(name)
        for triple in choose_triples(folder.photos, args.pairs):
            photos = [folder.photos[i].load(args.size) for i in (triple.first, triple.second, triple.target)]
            try:
                scene = recon(views_of(photos[:2]))
            except MatchingError:
                continue
            label = f"{Path(name).name} {triple.first}-{triple.second}"
            for method, gaussians in variants(scene, photos[:2], rasterizer, args.shares):
                yield {"scene": label, "method": method, **score(gaussians, scene, photos, rasterizer)}


def variants(
    scene: Reconstruction, photos: list[Photo], rasterizer: Rasterizer, shares: list[float]
) -> Iterator[tuple[str, Gaussians]]:
    """Name of each way to have fewer Gaussians, and what it leaves."""
    everything, cameras, images = scene.gaussians, scene.cameras, views_of(photos).images
    yield "all", everything
    auto = simplify(everything, cameras, rasterizer).gaussians
    yield "auto", auto
    yield "all, refined", refine(everything, cameras, images, rasterizer, REFINE_STEPS).gaussians
    yield "auto, refined", refine(auto, cameras, images, rasterizer, REFINE_STEPS).gaussians
    shuffled = torch.randperm(everything.count, generator=torch.Generator().manual_seed(0))
    opaque_first = everything.opacities[0].argsort(descending=True, stable=True)
    for share in shares:
        most = round(share * everything.count)
        yield "simplify", simplify(everything, cameras, rasterizer, most).gaussians
        yield "random", everything.select(shuffled[:most])
        yield "opacity", everything.select(opaque_first[:most])


def score(gaussians: Gaussians, scene: Reconstruction, photos: list[Photo], rasterizer: Rasterizer) -> dict:
    first, second, target = photos
    pose = relative_pose(target, first)
    predicted = float(scene.cameras.c2w[0, 1, :3, 3].norm())
    pose[:3, 3] *= predicted / np.linalg.norm(relative_pose(second, first)[:3, 3])
    novel = Cameras(
        torch.from_numpy(pose).float()[None, None],
        torch.from_numpy(target.intrinsics).float()[None, None],
        target.image.shape[:2],
    )
    picture, seconds = timed_picture(gaussians, novel, rasterizer)
    inputs, _ = timed_picture(gaussians, scene.cameras, rasterizer)
    return {
        "share": gaussians.count / scene.gaussians.count,
        "novel_psnr": psnr(picture[0], target.image),
        "novel_ssim": ssim(picture[0], target.image),
        "input_psnr": psnr(inputs, np.stack([first.image, second.image])),
        "render_cpu_seconds": seconds,
    }


def timed_picture(gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer) -> tuple[np.ndarray, float]:
    """Pictures `[camera, height, width, 3]`, and the least CPU seconds of some repeats."""
    seconds = []
    with torch.no_grad():
        for _ in range(RENDER_REPEATS):
            start = time.process_time()
            images = rasterizer.render(gaussians, cameras).images
            seconds.append(time.process_time() - start)
    return images[0].permute(0, 2, 3, 1).clamp(0, 1).numpy(), min(seconds)


def table(rows: list[dict]) -> str:
    """Means over the scenes; differences of novel views are to `all` of the same scene."""
    reference = {row["scene"]: row for row in rows if row["method"] == "all"}
    lines = ["method            share   novel dB (worst)     novel SSIM   input dB   render time"]
    for method, group in grouped(rows).items():
        gain = [row["novel_psnr"] - reference[row["scene"]]["novel_psnr"] for row in group]
        faster = [row["render_cpu_seconds"] / reference[row["scene"]]["render_cpu_seconds"] for row in group]
        mean = {key: np.mean([row[key] for row in group]) for key in ("share", "novel_ssim", "input_psnr")}
        lines.append(
            f"{method[0]:<16} {mean['share']:6.3f}   {np.mean(gain):+6.2f} ({min(gain):+6.2f})"
            f"   {mean['novel_ssim']:12.4f} {mean['input_psnr']:10.2f} {np.median(faster):13.2f}"
        )
    return "\n".join(lines)


def grouped(rows: list[dict]) -> dict[tuple, list[dict]]:
    """Rows by method and, on the curves, by share."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        on_curve = row["method"] in ("simplify", "random", "opacity")
        groups.setdefault((row["method"], round(row["share"], 2) if on_curve else 0), []).append(row)
    return groups


def plot(rows: list[dict], file: Path) -> None:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(12, 3.6), constrained_layout=True)
    panels = (
        ("novel_psnr", "novel view PSNR [dB]"),
        ("novel_ssim", "novel view SSIM"),
        ("input_psnr", "input PSNR [dB]"),
    )
    for axis, (key, title) in zip(axes, panels):
        points: dict[str, list[tuple[float, float]]] = {}
        for method, group in grouped(rows).items():
            point = np.mean([row["share"] for row in group]), np.mean([row[key] for row in group])
            points.setdefault(method[0], []).append(point)
        for method, values in points.items():
            axis.plot(*zip(*sorted(values)), marker="o", label=method)
        axis.set(xlabel="share of the Gaussians", ylabel=title, xscale="log")
    axes[0].legend(fontsize=8)
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
