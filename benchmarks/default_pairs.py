"""The whole default run, its editor left out, on the pairs of `edit3r evaluate`: gain over the
best-blurred photo.

    python benchmarks/default_pairs.py FOLDER... --pairs 5 --size 256 --refine 16 28

A row for each number of refining steps; the pairs one by one go to stderr.
"""

import argparse
import sys
from collections import Counter
from functools import partial

import torch
from edit3r_measure.novel_view import novel_view, score_scene
from edit3r_measure.scene_sources import SceneOptions, find_scenes
from scenes import for_tuning

import edit3r
from edit3r import Reconstruction, Views, default_registry
from edit3r.contract.reporting import Report


class DefaultRun:
    """A run as a reconstructor; `label` is the verdict of the last one."""

    label = "failed"

    def __init__(self, refine: int) -> None:
        self.refine = refine

    def __call__(self, views: Views) -> Reconstruction:
        with torch.enable_grad():
            result = edit3r.run(
                views, "", editor="none", refine=self.refine, report=Report()
            )
        self.label = result.verdict.label
        return Reconstruction(result.gaussians, result.cameras)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--refine", type=int, nargs="+", default=[28])
    args = parser.parse_args()
    print("| steps | pairs | placed | gain, dB | worst | good, fair, poor |")
    print("| --: | --: | --: | --: | --: | --- |")
    for steps in args.refine:
        print(row(for_tuning(args.folders), args.pairs, args.size, steps), flush=True)


def row(folders: list[str], pairs: int, size: int, steps: int) -> str:
    """Run every pair; the table's row of this number of steps."""
    rasterizer = edit3r.build("rasterizer", "auto")
    options = SceneOptions(pairs, size)
    labels: Counter[str] = Counter()
    gains = []
    for folder in folders:
        for source in find_scenes(folder, options, default_registry()):
            run = DefaultRun(steps)
            evaluate = partial(novel_view, run, rasterizer)
            score = score_scene(source.load(), "novel view", evaluate)
            print(source.name, score.degrees, score.figures, run.label, file=sys.stderr)
            labels[run.label] += 1
            if not score.failure:
                gains.append(score.figures["psnr"] - score.figures["blurred_psnr"])
    found = ", ".join(str(labels[label]) for label in ("good", "fair", "poor"))
    gain = f"{sum(gains) / len(gains):+.2f} | {min(gains):+.2f}"
    return f"| {steps} | {labels.total()} | {len(gains)} | {gain} | {found} |"


if __name__ == "__main__":
    main()
