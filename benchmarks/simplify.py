"""What simplifying costs and what it leaves, beside dropping as many Gaussians at random or by
opacity.

    python benchmarks/simplify.py FOLDER... procedural --scenes 2 --generated 12 --out results

Each FOLDER holds photos of one scene with their cameras; a data set's name stands for generated
scenes. Two photos are reconstructed; the scene with all its Gaussians, with those that the refiner
`simplify` leaves, and with as many left by each rival (polished by as many photometric steps) is
rendered and compared with the photo between the two. Prints CPU seconds, sizes, PSNR, SSIM, LPIPS
and share of detail by kind of scene; stopped, it goes on where it was.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from edit3r_measure.novel_view import PredictedScene, views_of
from edit3r_measure.scene_sources import (
    EvaluationScene,
    SceneOptions,
    SceneSource,
    find_scenes,
)
from harness import for_tuning
from likeness import likeness

import edit3r
from edit3r import default_registry
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import RefineInputs
from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.kit.command.results import markdown_table
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.workers import run_resumable

SHARES = (0.1, 0.2, 0.33)
# as `simplify` does after merging
POLISH = {
    "steps": 10,
    "colour": 0.015,
    "opacity": 0.08,
    "scale": 0.08,
}
RENDER_REPEATS = 5
SHORT = ("all", "auto", *(f"simplify to {share:g}" for share in reversed(SHARES)))
# no training has seen these
UNSEEN = {"procedural": {"seed": 2024, "targets": 1, "angles": [5, 20]}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sources", nargs="+", metavar="FOLDER|NAME")
    parser.add_argument("--recon", default="classical")
    parser.add_argument("--scenes", type=int, default=3, help="pairs of a folder")
    parser.add_argument("--generated", type=int, default=3, help="scenes of a data set")
    parser.add_argument(
        "--short", action="store_true", help="print the rows of `simplify` alone"
    )
    parser.add_argument(
        "--size", type=int, default=256, help="side of the square photos [pixels]"
    )
    parser.add_argument(
        "--shares",
        type=float,
        nargs="*",
        default=SHARES,
        help="shares of the Gaussians to leave",
    )
    parser.add_argument(
        "--refine", type=int, default=30, help="photometric steps of the refined ones"
    )
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    datasets = {
        name: {**settings, "image_size": args.size} for name, settings in UNSEEN.items()
    }
    found = []
    for source in for_tuning(args.sources):
        count = args.scenes if Path(source).is_dir() else args.generated
        options = SceneOptions(count, args.size, datasets)
        found += find_scenes(source, options, default_registry())
    jobs = {
        f"{scene.name} {args.recon} {args.shares} {args.refine}": scene
        for scene in found
        if scene.kind != "stereo"
    }
    done = run_resumable(
        jobs,
        Measurement(args.recon, args.shares, args.refine),
        args.out / "points.jsonl",
    )
    for kind in dict.fromkeys(row["kind"] for row in done.values()):
        scenes = [row for row in done.values() if row["kind"] == kind]
        measured = [scene for scene in scenes if "points" in scene]
        print(
            f"\n{kind}: {len(measured)} scenes, {len(scenes) - len(measured)} not matched\n"
        )
        points = [scene["points"] for scene in measured]
        names = [name for name in points[0] if name in SHORT or not args.short]
        print(table(points, names))


@dataclass(frozen=True)
class Measurement:
    """Measures one scene in every variant."""

    recon: str
    shares: Sequence[float]
    refine: int

    def __call__(self, source: SceneSource) -> dict[str, Any]:
        scene = source.load()
        views = views_of([scene.inputs[0], scene.inputs[-1]])
        try:
            reconstruction = edit3r.build("reconstructor", self.recon)(views)
        except MatchingError as error:
            return {"kind": source.kind, "failure": str(error)}
        variants = self._variants(reconstruction, views)
        return {
            "kind": source.kind,
            "points": {n: score(g, s, reconstruction, scene) for n, g, s in variants},
        }

    def _variants(
        self, reconstruction: Reconstruction, views: Views
    ) -> Iterator[tuple[str, Gaussians, float]]:
        """Give name, Gaussians and CPU seconds of each way to have fewer."""
        everything, cameras, rasterizer = (
            reconstruction.gaussians,
            reconstruction.cameras,
            build_rasterizer(),
        )

        def refined(
            scene: Gaussians, views: Views, refiner: str, **settings: Any
        ) -> tuple[Gaussians, float]:
            step = edit3r.build("refiner", refiner, **settings)
            start = time.process_time()
            return step(
                scene, RefineInputs(cameras, views, rasterizer)
            ), time.process_time() - start

        # the first run of a process compiles kernels
        refined(everything, views, "simplify", gaussians="auto")
        auto, seconds = refined(everything, views, "simplify", gaussians="auto")
        yield "all", everything, 0.0
        yield "auto", auto, seconds
        yield "all, refined", *refined(everything, views, "refine", steps=self.refine)
        yield "auto, refined", *refined(auto, views, "refine", steps=self.refine)
        with torch.no_grad():
            shown = replace(
                views, images=rasterizer.render(everything, cameras).images.clamp(0, 1)
            )
        orders = {
            "random": torch.randperm(
                everything.count, generator=torch.Generator().manual_seed(0)
            ),
            "opacity": everything.opacities[0].argsort(descending=True, stable=True),
        }
        for share in self.shares:
            count = round(share * everything.count)
            yield (
                f"simplify to {share:g}",
                *refined(everything, views, "simplify", gaussians=count),
            )
            for name, order in orders.items():
                yield (
                    f"{name}, {share:g}",
                    *refined(
                        everything.select(order[:count]), shown, "refine", **POLISH
                    ),
                )


def build_rasterizer():
    """Return the rasterizer of all figures, on one thread."""
    return edit3r.build("rasterizer", "numba", threads=1)


def score(
    gaussians: Gaussians,
    seconds: float,
    reconstruction: Reconstruction,
    scene: EvaluationScene,
) -> dict[str, float]:
    """Return the figures of one variant: share left, novel view, CPU seconds and size of the
    file.
    """
    times = []
    for _ in range(RENDER_REPEATS):
        start = time.process_time()
        fewer = replace(reconstruction, gaussians=gaussians)
        predicted = PredictedScene(fewer, build_rasterizer(), scene.inputs)
        image = predicted.show(predicted.camera_of(scene.target)).image
        times.append(time.process_time() - start)
    with tempfile.TemporaryDirectory() as folder:
        save_ply(Path(folder) / "scene.ply", gaussians)
        size = (Path(folder) / "scene.ply").stat().st_size
    return {
        "share": gaussians.count / reconstruction.gaussians.count,
        **asdict(likeness(image, scene.target.image)),
        "seconds": seconds,
        "render_seconds": min(times),
        "ply_mb": size / 1e6,
    }


def table(scenes: Sequence[dict[str, dict[str, float]]], names: Sequence[str]) -> str:
    """Return means over the scenes; novel views as difference from `all` of the same scene, the
    worst in brackets.
    """
    rows = []
    for name in names:
        mean = {
            key: np.mean([scene[name][key] for scene in scenes])
            for key in scenes[0][name]
        }
        gain = [scene[name]["psnr"] - scene["all"]["psnr"] for scene in scenes]
        times = [f"{mean['seconds']:.2f}", f"{1000 * mean['render_seconds']:.0f}"]
        quality = [f"{np.mean(gain):+.2f} ({min(gain):+.2f})"]
        quality += [f"{mean[key]:.3f}" for key in ("ssim", "lpips", "detail")]
        rows.append(
            [name, f"{mean['share']:.3f}", *times, f"{mean['ply_mb']:.1f}", *quality]
        )
    titles = [
        "variant",
        "share left",
        "made in, CPU s",
        "rendered in, CPU ms",
        "PLY MB",
        "dB against all (worst)",
        "SSIM",
        "LPIPS",
        "detail",
    ]
    return markdown_table([dict(zip(titles, row)) for row in rows])


if __name__ == "__main__":
    main()
