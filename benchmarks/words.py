"""How well a word finds the thing, and how surely: objects of real photos whose outlines were drawn
by hand (`clicks.json`), and words for things that the photos do not show.

    python benchmarks/words.py DATA [--segmenter auto] [--only bear fox]

DATA is a folder of photo sets, as for `benchmarks/clicks.py`. An answer is right where its overlap
with the outline is above one half; what is called sure is what a run takes unasked.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from clicks import SAID, filled, iou
from PIL import Image

from edit3r import build
from edit3r.contract.errors import InputError
from edit3r.running import SURE, Selection, select_masks, usual_reader

ABSENT = (
    "car",
    "dog",
    "horse",
    "bicycle",
    "sheep",
    "bus",
    "umbrella",
    "pizza",
    "guitar",
    "banana",
    "elephant",
    "train",
)
SEEN_BESIDE = {
    "berlin": {"bicycle", "car", "bus"},
    "dinosaur": {"car", "umbrella"},
    "british_museum": {"car", "bus", "umbrella"},
}
"""Words of ABSENT that may be on photos of a set after all."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--segmenter", default="auto")
    parser.add_argument("--only", nargs="*", default=[], help="names of the objects")
    args = parser.parse_args()
    objects = json.loads(Path(__file__).with_name("clicks.json").read_text())
    segmenter = build("segmenter", args.segmenter)
    rows, absent, photos = [], [], set()
    for name, polygons in objects.items():
        file = next(iter(polygons))
        if (args.only and name not in args.only) or not (args.data / file).is_file():
            continue
        image = np.asarray(Image.open(args.data / file).convert("RGB"))
        truth = filled(polygons[file], image.shape[:2])
        tensor = torch.from_numpy(image.copy()).permute(2, 0, 1).float()[None] / 255
        rows.append((name, *answer(tensor, SAID.get(name, name), segmenter, truth)))
        print(
            "{:14} overlap {:.2f}  surety {!s:.4}  {:.1f} s".format(*rows[-1]),
            flush=True,
        )
        if file in photos:
            continue
        photos.add(file)
        for word in set(ABSENT) - SEEN_BESIDE.get(file.split("/")[0], set()):
            _, surety, _ = answer(tensor, word, segmenter, truth)
            absent.append(surety)
            if (surety or 0) >= SURE:
                print(f"  {word!r}, which is not there: {surety:.2f} sure")
    told(rows, absent)


def answer(tensor, text, segmenter, truth) -> tuple[float, float | None, float]:
    """Overlap, surety (None: not found) and seconds."""
    thing = usual_reader().read_thing(text)
    asked = Selection(words=thing.name, which=thing.which)
    start = time.perf_counter()
    try:
        found = select_masks(tensor, replace(asked, guess=True), segmenter)
    except InputError:
        return 0.0, None, time.perf_counter() - start
    seconds = time.perf_counter() - start
    if "guess" in found.how:
        return 0.0, None, seconds
    return iou(found.masks[0, 0].numpy() > 0.5, truth), found.surety, seconds


def told(rows, absent) -> None:
    right = [row for row in rows if row[1] > 0.5]
    sure = [row for row in rows if (row[2] or 0) >= SURE]
    wrong = [row for row in sure if row[1] <= 0.5]
    unasked = sum((surety or 0) >= SURE for surety in absent)
    print(
        f"right: {len(right)} of {len(rows)}; sure: {len(sure)}, of these wrong: {len(wrong)}"
    )
    print(f"words of absent things: {len(absent)}, taken as sure: {unasked}")


if __name__ == "__main__":
    main()
