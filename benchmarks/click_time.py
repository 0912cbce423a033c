"""How long a click takes until the object is marked on both photos of a pair, and how much memory
all small networks need together.

    python benchmarks/click_time.py DATA [--size 512] [--segmenter auto] [--profile]

DATA is a folder of photo sets, as for `benchmarks/clicks.py`. A first click elsewhere warms up what
is read once for each photo. Then the object's own click is timed: seconds of the clock and of the
processor until the mask of the clicked photo is there, which the app shows first, and until those
of both photos are, carried by pictures and by geometry. The last
line is the process's peak memory after all networks of `edit3r weights get essentials` were used.
"""

import argparse
import cProfile
import json
import pstats
import resource
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from clicks import filled, next_click
from edit3r_select.select import select_masks
from PIL import Image

from edit3r import build, load_views
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Marks, Selection
from edit3r.running import geometry_of

ELSEWHERE = (0, 0.1, 0.85)  # photo, x and y of the click that warms up
ASIDE = 0.004  # the second click's distance from the first, whose answer is remembered
WORDS = ("dog",)  # of the detector `coco`


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--size", type=int, default=512, help="longer side [pixels]")
    parser.add_argument("--segmenter", default="auto")
    parser.add_argument("--matcher", default="classical")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    parser.add_argument(
        "--profile", action="store_true", help="show where the seconds go"
    )
    args = parser.parse_args()
    objects = json.loads(Path(__file__).with_name("clicks.json").read_text())
    segmenter = build("segmenter", args.segmenter)
    matcher = build("matcher", args.matcher)
    geometries: dict = {}
    profile = cProfile.Profile(time.process_time)
    rows = []
    for name, polygons in objects.items():
        files = tuple(args.data / file for file in polygons)
        if len(files) < 2 or (args.only and name not in args.only):
            continue
        views = load_views(files, size=args.size)
        images = views.images[0]
        if files not in geometries:
            geometries[files] = geometry_of(matcher, views)
            select_masks(images, Selection(positive=(ELSEWHERE,)), segmenter)
            segmenter.segment_marks(images[1], Marks(positive=(ELSEWHERE[1:],)))
        x, y = place_in(next(iter(polygons.values())), files[0])
        row = []
        asked = (
            (images[:1], None, 2 * ASIDE),
            (images, None, 0.0),
            (images, geometries[files], ASIDE),
        )
        for shown, geometry, aside in asked:
            clicked = Selection(positive=((0, x + aside, y),))
            clock, processor = time.perf_counter(), time.process_time()
            if args.profile:
                profile.enable()
            lenses = views.intrinsics[:, : len(shown)]
            found = select_masks(shown, clicked, segmenter, geometry, lenses)
            profile.disable()
            row += [time.perf_counter() - clock, time.process_time() - processor]
        rows.append(row)
        print(f"{name:16s} {told(row)}  ({found.how[1]})", flush=True)
    print(f"{'median':16s} {told(np.median(rows, axis=0))}")
    for word in WORDS:
        with suppress(
            InputError
        ):  # what is not there: the networks are asked all the same
            select_masks(images, Selection(words=word), segmenter)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory {peak:.2f} GB, {torch.get_num_threads()} threads")
    if args.profile:
        pstats.Stats(profile).sort_stats("tottime").print_stats(20)


def place_in(polygons: list, file: Path) -> tuple[float, float]:
    """The object's innermost point, x and y in [0, 1]."""
    width, height = Image.open(file).size
    truth = filled(polygons, (height, width))
    return next_click(np.zeros_like(truth), truth)[1]


def told(row) -> str:
    """Seconds for one photo, by pictures and by geometry, of the clock and of the processor."""
    heads = ("clicked photo", "CPU", "pictures", "CPU", "geometry", "CPU")
    return "  ".join(f"{head} {value:.2f} s" for head, value in zip(heads, row))


if __name__ == "__main__":
    main()
