"""The whole default run, its editor left out, on the pairs of `edit3r evaluate`: gain over the
best-blurred photo.

python benchmarks/default_pairs.py FOLDER... --pairs 5 --size 256
"""

import argparse
from functools import partial

import torch
from edit3r_measure.novel_view import novel_view, score_scene
from edit3r_measure.scene_sources import SceneOptions, find_scenes

import edit3r
from edit3r import Reconstruction, Views
from edit3r.plugins.registry import default_registry
from edit3r.reporting import Report


class DefaultRun:
    """A run as a reconstructor; `label` is the verdict of the last one."""

    label = "failed"

    def __call__(self, views: Views) -> Reconstruction:
        with torch.enable_grad():
            result = edit3r.run(views, "", editor="none", report=Report())
        self.label = result.verdict.label
        return Reconstruction(result.gaussians, result.cameras)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--size", type=int, default=256)
    args = parser.parse_args()
    rasterizer = edit3r.build("rasterizer", "auto")
    for folder in args.folders:
        for source in find_scenes(
            folder, SceneOptions(args.pairs, args.size), default_registry()
        ):
            run = DefaultRun()
            score = score_scene(
                source.load(), "novel view", partial(novel_view, run, rasterizer)
            )
            names = ("psnr", "blurred_psnr", "rotation_error", "direction_error")
            figures = [
                f"{name} {score.figures[name]:.2f}"
                for name in names
                if name in score.figures
            ]
            print(
                source.name,
                f"{score.degrees:.0f} degrees",
                *figures,
                run.label,
                score.failure,
                flush=True,
            )


if __name__ == "__main__":
    main()
