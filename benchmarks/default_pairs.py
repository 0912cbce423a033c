"""The whole default run, its editor left out, on the pairs of `edit3r evaluate`: gain over the
best-blurred photo.

    python benchmarks/default_pairs.py FOLDER... --pairs 5 --size 256 --refine 16 28

A row for each number of refining steps; the pairs one by one go to stderr.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial

import torch
from edit3r_measure.novel_view import novel_view, score_scene
from edit3r_measure.scene_sources import SceneOptions, find_scenes
from harness import Row, run_benchmark
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


def main(
    folders: Sequence[str],
    *,
    pairs: int = 5,
    size: int = 256,
    refine: Sequence[int] = (28,),
) -> Iterator[Row]:
    for steps in refine:
        yield row(for_tuning(folders), pairs, size, steps)


def row(folders: list[str], pairs: int, size: int, steps: int) -> Row:
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
    return {
        "steps": (steps, "d"),
        "pairs": (labels.total(), "d"),
        "placed": (len(gains), "d"),
        "gain, dB": (sum(gains) / len(gains), "+.2f"),
        "worst": (min(gains), "+.2f"),
        "good, fair, poor": found,
    }


if __name__ == "__main__":
    run_benchmark(main)
