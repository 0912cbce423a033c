"""Scenes that no setting may be chosen by, and what the default run makes of them.

    python benchmarks/held_out.py photos/

The folder holds the photo sets of the benchmarks. Every two photos of a held-out scene are
reconstructed by the default run without their poses. A row each: the verdict, the agreement (PSNR
of each photo against the other's Gaussians, before refining), and PSNR, SSIM, LPIPS and share of
detail of the photos, and, for scenes with known cameras, of the one that stands between the two.
The other benchmarks refuse these scenes.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

from dial import as_numpy, at_the_photos, drawn
from harness import HELD_OUT, Row, run_benchmark
from likeness import TITLE, likeness
from verdict import unseen_camera

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.kit.photos.images import find_photos
from edit3r.kit.photos.posed_folder import read_posed_folder

SIZE = 512


def main(data: Path) -> Iterator[Row]:
    for scene in HELD_OUT:
        count = len(find_photos(data / scene / "images"))
        for pair in combinations(range(count), 2):
            name = f"{scene} {pair[0]}, {pair[1]}"
            yield {"held-out photos": name, **figures(data / scene, pair)}


def figures(folder: Path, pair: tuple[int, int]) -> Row:
    """The cells of one row after its first."""
    photos = find_photos(folder / "images")
    between = range(pair[0] + 1, pair[1]) if is_posed(folder) else ()
    given = [photos[index] for index in (*pair, *between)]
    whole = edit3r.load_views(given, size=SIZE)
    try:
        result = edit3r.run(
            replace(whole.select(range(2)), c2w=None), editor="none", outputs=[]
        )
    except Edit3rError:
        return {"verdict": "refused"}
    agreement = ", ".join(f"{value:.1f}" for value in result.verdict.agreement or ())
    shown = [
        likeness(
            drawn(result, unseen_camera(result, whole, [0, 1], view)),
            as_numpy(whole, view),
        )
        for view in range(2, whole.count)
    ]
    return {
        "verdict": result.verdict.label,
        "agreement, dB": agreement,
        f"photos: {TITLE}": str(at_the_photos(result, whole)),
        "between": "; ".join(map(str, shown)) or "–",
    }


def is_posed(folder: Path) -> bool:
    cameras = read_posed_folder(folder).cameras
    return all(camera.c2w is not None for camera in cameras)


if __name__ == "__main__":
    run_benchmark(main)
