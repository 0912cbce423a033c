"""Scenes that no setting may be chosen by, and what the default run makes of them.

    python benchmarks/held_out.py photos/

The folder holds the photo sets of the benchmarks. Every two photos of a held-out scene are
reconstructed by the default run without their poses. A row each: the verdict, the agreement (PSNR
of each photo against the other's Gaussians, before refining), the PSNR of the input views, and, for
scenes with known cameras, of the photo that stands between the two. The other benchmarks refuse
these scenes.
"""

import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

from harness import Row, run_benchmark
from scenes import HELD_OUT
from verdict import measure

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.kit.photos.images import find_photos

SIZE = 256


def main(data: Path) -> Iterator[Row]:
    for scene in HELD_OUT:
        count = len(find_photos(data / scene / "images"))
        for pair in combinations(range(count), 2):
            name = f"{scene} {pair[0]}, {pair[1]}"
            yield {"held-out photos": name, **figures(data / scene, pair)}


def figures(folder: Path, pair: tuple[int, int]) -> Row:
    """The cells of one row after its first."""
    row = posed(folder, pair) if is_posed(folder) else unposed(folder, pair)
    titles = {
        "agreement": "agreement, dB",
        "input_psnr": "input views, dB",
        "held_out": "photo between, dB",
    }
    cells = {
        title: ", ".join(f"{value:.1f}" for value in row.get(name, ())) or "–"
        for name, title in titles.items()
    }
    return {"verdict": row["label"], **cells}


def is_posed(folder: Path) -> bool:
    cameras = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
    return all(camera["c2w"] is not None for camera in cameras)


def posed(folder: Path, pair: tuple[int, int]) -> dict:
    """As `benchmarks/verdict.py` measures a set."""
    return measure(folder, list(pair), SIZE, pairs=False, unseen=[])


def unposed(folder: Path, pair: tuple[int, int]) -> dict:
    """The same without a photo between."""
    photos = [find_photos(folder)[index] for index in pair]
    try:
        verdict = edit3r.run(photos, editor="none", size=SIZE, outputs=[]).verdict
    except Edit3rError:
        return {"label": "refused"}
    return {
        "label": verdict.label,
        "agreement": verdict.agreement,
        "input_psnr": verdict.input_psnr,
        "held_out": [],
    }


if __name__ == "__main__":
    run_benchmark(main)
