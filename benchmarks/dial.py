"""Does a dearer preset show views that were not given better? Ten wide pairs of real photos.

    python benchmarks/dial.py photos/ --presets fast default best
    python benchmarks/dial.py photos/ --only "fox 25,29" --poses known

A row a pair: the PSNR [dB] of the photo between the two, at 512 pixels and its true pose, by each
preset (`default`: none). `--poses known` gives the run the true poses of its photos too: what
differs between presets then is not how exactly poses were found.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import Row, run_benchmark
from lenses import MATCHER
from verdict import _unseen, between

import edit3r
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.running.quality import read_quality

PAIRS = (
    *(
        "fern 10,14",
        "fox 25,29",
        "monstree 0,2",
        "dinosaur 31,34",
        "7scenes_rgbd 12,14",
    ),
    *("bear 0,2", "fern 0,4", "fox 0,8", "dinosaur 0,1", "fox 36,38"),
)
FULL = 512  # long side of the photos between [pixels]


def main(
    data: Path,
    *,
    presets: Sequence[str] = ("fast", "balanced", "default", "best"),
    only: Sequence[str] = PAIRS,
    poses: str = "unknown",
) -> Iterator[Row]:
    shown: dict[str, list[float]] = {preset: [] for preset in presets}
    for pair in only:
        scene, _, numbers = pair.partition(" ")
        chosen = [int(number) for number in numbers.split(",")]
        for preset, values in shown.items():
            values.append(psnr(data / scene, chosen, preset, poses == "known"))
        yield {"photos": pair, **{name: (v[-1], ".2f") for name, v in shown.items()}}
    means = {name: (float(np.mean(v)), ".2f") for name, v in shown.items()}
    yield {"photos": "mean", **means}


def psnr(folder: Path, chosen: list[int], preset: str, known: bool) -> float:
    """Mean PSNR [dB] of the photos between the chosen ones."""
    cameras = read_posed_folder(folder).cameras
    centres = np.stack([camera.c2w[:3, 3] for camera in cameras])
    targets = [target for target in between(centres, chosen) if target is not None]
    files = [folder / cameras[index].file for index in (*chosen, *targets)]
    whole, count = edit3r.load_views(files, size=FULL), len(chosen)
    quality = None if preset == "default" else preset
    size = read_quality().preset(quality).settings["size"] if quality else FULL
    given = edit3r.load_views(files[:count], size=size)
    posed = whole.c2w[:, :count] if known else None
    options = {"recon": {"name": "edit3r", "matcher": posed_matcher(quality)}}
    result = edit3r.run(
        replace(given, c2w=posed),
        editor="none",
        outputs=[],
        quality=quality,
        **options if known else {},
    )
    placed = [view for view, there in enumerate(result.verdict.placed) if there]
    views = range(count, whole.count)
    return float(np.mean([_unseen(result, whole, placed, view) for view in views]))


def posed_matcher(quality: str | None) -> dict:
    """The matcher that trusts poses, as fine as that of the preset."""
    chosen = read_quality().preset(quality).settings["reconstructor"] if quality else ""
    own = chosen["matcher"] if isinstance(chosen, dict) else {}
    return {**MATCHER, **own, "name": "posed"}


if __name__ == "__main__":
    run_benchmark(main)
