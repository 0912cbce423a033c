"""An evaluation index of folders of posed photos, as pixelSplat and NoPoSplat have them: pairs by
how much they share.

    python benchmarks/overlap_index.py DATA/fern DATA/fox --pairs 1 --size 128 --out index.json
    edit3r evaluate DATA --index index.json

Depths are measured for at most 16 photos of a folder, each with its two neighbours, by plane sweep
from the known poses (matcher `posed`). Two photos at most 60 degrees apart overlap by the mean
share of either's pixels whose surface the other shows too; targets are up to three photos between
them.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from edit3r_measure.novel_view import views_of
from edit3r_measure.protocol import CLASSES, IndexEntry
from jaxtyping import Float

from edit3r import build
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Matcher
from edit3r.contract.types import Views
from edit3r.kit.geometry.warping import find_correspondences
from edit3r.kit.photos.images import evenly
from edit3r.kit.photos.posed_folder import PosedFolder, PosedPhoto, read_posed_folder
from edit3r.kit.photos.triples import photos_between, rotation_degrees

TARGETS, MOST_PHOTOS = 3, 16
MOST_DEGREES = 60.0  # from farther round, a floor that both photos show looks another
SAME_SURFACE = (
    0.05  # relative difference of depth below which two photos show one place
)


def make_index(places: Sequence[str], per_class: int, size: int) -> dict[str, Any]:
    """Return the content of an index file: at most so many pairs of each class and folder, with
    photos between them.
    """
    matcher, index = build("matcher", "posed"), {}
    for folder in map(read_posed_folder, places):
        pairs = {name: [] for name in CLASSES}
        for first, second, overlap in _overlaps(folder, matcher, size):
            poses = [camera.c2w for camera in folder.cameras]
            between = photos_between(poses, first, second)[:TARGETS]
            entry = IndexEntry(
                context=(first, second),
                target=tuple(sorted(between)),
                overlap=round(overlap, 3),
            )
            if between and entry.overlap_class in pairs:
                pairs[entry.overlap_class].append(entry.model_dump(mode="json"))
        index[folder.name] = [
            entry for own in pairs.values() for entry in evenly(own, per_class)
        ]
    return index


def _overlaps(
    folder: PosedFolder, matcher: Matcher, size: int
) -> Iterator[tuple[int, int, float]]:
    """Yield every two of the chosen photos with the mean of the shares of either that the other
    shows too.
    """
    depths: dict[int, Float[np.ndarray, "height width"]] = {}
    photos: dict[int, PosedPhoto] = {}
    for index in evenly(range(len(folder.cameras)), MOST_PHOTOS):
        trio = [folder.load(i, size) for i in (index, *_nearest(folder, index))]
        try:
            depths[index] = matcher.match(_posed_views(trio)).depths[0, 0].numpy()
            photos[index] = trio[0]
        except MatchingError:
            continue  # nothing is known of what it shows
    for pair in combinations(photos, 2):
        if (
            rotation_degrees(*(photos[index].c2w[:3, :3] for index in pair))
            <= MOST_DEGREES
        ):
            yield (
                *pair,
                overlap(*([own[index] for index in pair] for own in (photos, depths))),
            )


def overlap(
    photos: Sequence[PosedPhoto], depths: Sequence[Float[np.ndarray, "height width"]]
) -> float:
    """Return the mean share in [0, 1] of two photos' pixels whose surface the other shows too;
    `depths` camera z.
    """
    views, maps = _posed_views(photos), torch.from_numpy(np.stack(depths)).float()[None]
    found = find_correspondences(maps, views.intrinsics, views.c2w)
    shared = (found.inside > 0) & ((found.depth_ratio.exp() - 1).abs() < SAME_SURFACE)
    return float(shared.float().mean())


def _posed_views(photos: Sequence[PosedPhoto]) -> Views:
    return replace(
        views_of(photos),
        c2w=torch.from_numpy(np.stack([photo.c2w for photo in photos])).float()[None],
    )


def _nearest(folder: PosedFolder, index: int) -> list[int]:
    """Return the two photos that look most alike: by angle, those at the same place left out."""
    poses = [camera.c2w for camera in folder.cameras]
    others = [
        i
        for i in range(len(poses))
        if np.linalg.norm(poses[i][:3, 3] - poses[index][:3, 3]) > 1e-9
    ]
    return sorted(
        others, key=lambda i: rotation_degrees(poses[i][:3, :3], poses[index][:3, :3])
    )[:2]


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+")
    parser.add_argument(
        "--pairs", type=int, default=1, help="of each folder and class, evenly chosen"
    )
    parser.add_argument(
        "--size",
        type=int,
        default=128,
        help="side of the squares that depths are measured at",
    )
    parser.add_argument("--out", type=Path, default=Path("index.json"))
    args = parser.parse_args(words)
    args.out.write_text(
        json.dumps(make_index(args.folders, args.pairs, args.size), indent=1)
    )


if __name__ == "__main__":
    main()
