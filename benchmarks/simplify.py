"""Fewer Gaussians against picture quality: merging, opacity pruning and random dropping at equal count.

    python benchmarks/simplify.py FOLDER... --pairs 3 --procedural 8 --size 256 --out DIR

Each FOLDER holds photos of one scene with their cameras; further scenes are generated. Two photos are reconstructed;
the scene with all its Gaussians, with those that `simplify` leaves, and with as many left by each rival, is compared
with the photo between them. Writes `points.jsonl` (one line per scene, method and share; scenes found there are not
measured again) and, where curves were measured, `curves.png`, and prints the means.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from edit3r_measure.evaluation.metrics import psnr, ssim
from edit3r_measure.evaluation.novel_view import views_of
from edit3r_refiners.refine import refine
from edit3r_refiners.settings import SimplifySettings
from edit3r_refiners.simplify import POLISH, simplify
from simplify_scenes import HeldOut, flat_wall, procedural_scenes, real_scenes

import edit3r
from edit3r.errors import MatchingError
from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.io.ply import save_ply
from edit3r.types import Cameras, Gaussians, Reconstruction

SHARES = (0.05, 0.1, 0.2, 0.33, 0.5)
CURVES = ("simplify", "opacity", "opacity, polished", "random", "random, polished")
PARTS = ("auto", "curves", "refined")
RENDER_REPEATS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="*", metavar="FOLDER")
    parser.add_argument("--recon", default="classical")
    parser.add_argument("--pairs", type=int, default=3, help="pairs per folder")
    parser.add_argument("--skip", type=int, default=0, help="of these, leave out so many (those settings are tuned on)")
    parser.add_argument("--procedural", type=int, default=8, help="generated scenes")
    parser.add_argument("--seed", type=int, default=99, help="of the generated scenes")
    parser.add_argument("--size", type=int, default=256, help="side of the square pictures [pixels]")
    parser.add_argument("--shares", type=float, nargs="*", default=SHARES, help="shares for the curves")
    parser.add_argument("--refine", type=int, default=30, help="photometric steps of the refined ones")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="what to measure")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = measured(args, args.out / "points.jsonl")
    print(table(rows))
    if any(row["part"] == "curves" for row in rows):
        plot(rows, args.out / "curves.png")


def measured(args: argparse.Namespace, file: Path) -> list[dict]:
    """All rows, those of earlier calls among them; a scene's rows are written together."""
    recon, rasterizer = edit3r.build("reconstructor", args.recon), edit3r.build("rasterizer", "numba", threads=1)
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(row["scene"], row["part"]) for row in rows}
    scenes = [
        *real_scenes(args.folders, args.pairs, args.size, args.skip),
        *procedural_scenes(args.procedural, args.size, args.seed),
    ]
    jobs = [("flat wall", "auto", lambda: measure_wall(args.size, rasterizer))]
    for part, variants in (("auto", only_auto), ("refined", partial(refined, args.refine)), ("curves", curves)):
        for scene in scenes if part in args.parts else ():
            job = partial(measure, scene, recon, rasterizer, variants, args.shares)
            jobs.append((scene.label, part, job))
    for label, part, job in jobs:
        if (label, part) not in done:
            new = [{"scene": label, "part": part, **row} for row in job()]
            with file.open("a") as lines:
                lines.writelines(json.dumps(row) + "\n" for row in new)
            rows += new
    return rows


def measure_wall(size: int, rasterizer: Rasterizer) -> list[dict]:
    wall = flat_wall(size)
    auto = simplify(wall.gaussians, wall.cameras, rasterizer)
    return [{"kind": "wall", "method": "auto", "share": auto.gaussians.count / auto.before, "input_match": auto.psnr}]


def measure(
    held_out: HeldOut, recon: Reconstructor, rasterizer: Rasterizer, variants: Callable, shares: Sequence[float]
) -> list[dict]:
    photos = views_of([held_out.first, held_out.second])
    try:
        scene = recon(photos)
    except MatchingError:
        return [{"kind": held_out.kind, "method": "failed"}]
    return [
        {"kind": held_out.kind, "method": method, **score(gaussians, scene, held_out, rasterizer), **facts}
        for method, gaussians, facts in variants(scene, photos.images, rasterizer, shares)
    ]


Variants = Iterator[tuple[str, Gaussians, dict]]
"""Name of each way to have fewer Gaussians, what it leaves, and what it took."""


def only_auto(scene: Reconstruction, images: torch.Tensor, rasterizer: Rasterizer, shares: Sequence[float]) -> Variants:
    yield "all", scene.gaussians, {}
    start = time.process_time()
    auto = simplify(scene.gaussians, scene.cameras, rasterizer).gaussians
    yield "auto", auto, {"simplify_cpu_seconds": time.process_time() - start}


def refined(
    steps: int, scene: Reconstruction, images: torch.Tensor, rasterizer: Rasterizer, shares: Sequence[float]
) -> Variants:
    for name, gaussians, _ in only_auto(scene, images, rasterizer, shares):
        yield f"{name}, refined", refine(gaussians, scene.cameras, images, rasterizer, steps).gaussians, {}


def curves(scene: Reconstruction, images: torch.Tensor, rasterizer: Rasterizer, shares: Sequence[float]) -> Variants:
    everything, cameras = scene.gaussians, scene.cameras
    with torch.no_grad():
        shown = rasterizer.render(everything, cameras).images.clamp(0, 1)
    orders = {
        "random": torch.randperm(everything.count, generator=torch.Generator().manual_seed(0)),
        "opacity": everything.opacities[0].argsort(descending=True, stable=True),
    }
    for share in shares:
        most = round(share * everything.count)
        yield "simplify", simplify(everything, cameras, rasterizer, most).gaussians, {"asked": share}
        for name, order in orders.items():
            left = everything.select(order[:most])
            yield name, left, {"asked": share}
            # What is left gets the same steps as after merging, so that the choice alone is compared.
            polished = refine(left, cameras, shown, rasterizer, SimplifySettings().polish, POLISH).gaussians
            yield f"{name}, polished", polished, {"asked": share}


def score(gaussians: Gaussians, scene: Reconstruction, held_out: HeldOut, rasterizer: Rasterizer) -> dict:
    picture, seconds = timed_picture(gaussians, held_out.novel_camera(scene), rasterizer)
    inputs, _ = timed_picture(gaussians, scene.cameras, rasterizer, repeats=1)
    target = held_out.target.image
    return {
        "share": gaussians.count / scene.gaussians.count,
        "novel_psnr": psnr(picture[0], target),
        "novel_ssim": ssim(picture[0], target),
        "input_psnr": psnr(inputs, np.stack([held_out.first.image, held_out.second.image])),
        "render_cpu_seconds": seconds,
        "ply_bytes": ply_bytes(gaussians),
    }


def timed_picture(
    gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer, repeats: int = RENDER_REPEATS
) -> tuple[np.ndarray, float]:
    """Pictures `[camera, height, width, 3]`, and the least CPU seconds of some repeats."""
    seconds = []
    with torch.no_grad():
        for _ in range(repeats):
            start = time.process_time()
            images = rasterizer.render(gaussians, cameras).images
            seconds.append(time.process_time() - start)
    return images[0].permute(0, 2, 3, 1).clamp(0, 1).numpy(), min(seconds)


def ply_bytes(gaussians: Gaussians) -> int:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.ply"
        save_ply(file, gaussians)
        return file.stat().st_size


def table(rows: list[dict]) -> str:
    """Means over the scenes of a kind; differences of novel views are to `all` of the same scene."""
    lines = []
    for kind in ("procedural", "real"):
        own = [row for row in rows if row["kind"] == kind]
        scored = [row for row in own if "novel_psnr" in row]
        failed = sum(row["method"] == "failed" for row in own)
        if scored:
            lines += [f"{kind}: {len({row['scene'] for row in scored})} scenes, {failed} failed", *table_of(scored), ""]
    lines += [f"flat wall: {row['share']:.2%} left" for row in rows if row["kind"] == "wall"]
    return "\n".join(lines)


def table_of(rows: list[dict]) -> Iterator[str]:
    reference = {row["scene"]: row for row in rows if row["method"] == "all"}
    rows = [row for row in rows if row["scene"] in reference]
    yield "| method | share left | novel view, dB against all (worst) | SSIM | input dB | render time | PLY |"
    yield "| --- | --: | --: | --: | --: | --: | --: |"
    for (method, _), group in grouped(rows).items():
        gain = [row["novel_psnr"] - reference[row["scene"]]["novel_psnr"] for row in group]
        mean = {key: np.mean([row[key] for row in group]) for key in ("share", "novel_ssim", "input_psnr")}
        ratio = {
            key: np.mean([row[key] / reference[row["scene"]][key] for row in group])
            for key in ("render_cpu_seconds", "ply_bytes")
        }
        yield (
            f"| {method} | {mean['share']:.3f} | {np.mean(gain):+.2f} ({min(gain):+.2f}) | {mean['novel_ssim']:.3f} "
            f"| {mean['input_psnr']:.2f} | {ratio['render_cpu_seconds']:.2f} | {ratio['ply_bytes']:.3f} |"
        )


def grouped(rows: list[dict]) -> dict[tuple, list[dict]]:
    """Rows by method and, on the curves, by the share that was asked for."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((row["method"], row.get("asked", 0)), []).append(row)
    return groups


def plot(rows: list[dict], file: Path) -> None:
    """A row of panels per kind of scene, over the share of the Gaussians that is left."""
    from matplotlib import pyplot

    kinds = [kind for kind in ("procedural", "real") if any(row["kind"] == kind for row in rows)]
    panels = (
        ("novel_psnr", "held-out view: PSNR [dB]"),
        ("novel_ssim", "held-out view: SSIM"),
        ("input_psnr", "input photos: PSNR [dB]"),
    )
    rows = [row for row in rows if row["scene"] in {row["scene"] for row in rows if row.get("part") == "curves"}]
    figure, axes = pyplot.subplots(len(kinds), 3, figsize=(12, 3.6 * len(kinds)), squeeze=False, layout="constrained")
    for line, kind in zip(axes, kinds):
        groups = grouped([row for row in rows if row["kind"] == kind and "novel_psnr" in row])
        for axis, (key, title) in zip(line, panels):
            _draw(axis, groups, key)
            axis.set(xlabel="share of the Gaussians", ylabel=f"{kind} scenes\n{title}", xscale="log")
            axis.grid(alpha=0.3)
    axes[0][0].legend(fontsize=8)
    figure.savefig(file, dpi=120)


def _draw(axis, groups: dict[tuple, list[dict]], key: str) -> None:
    def point(group: list[dict]) -> tuple[float, float]:
        return np.mean([row["share"] for row in group]), np.mean([row[key] for row in group])

    for name in CURVES:
        curve = sorted(point(group) for (method, _), group in groups.items() if method == name)
        axis.plot(*zip(*curve), marker="o", markersize=4, label=name, linestyle="--" if "polished" in name else "-")
    for name, marker in (("auto", "*"), ("all", "s")):
        axis.plot(*point(groups[name, 0]), marker=marker, markersize=11, linestyle="", color="black", label=name)


if __name__ == "__main__":
    main()
